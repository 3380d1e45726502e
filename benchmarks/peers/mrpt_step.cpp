// Time of MRPT's range-bearing EKF-SLAM step (known ids, 10 observations) against the number of landmarks.
//   mrpt_step MODE SIZE...      MODE: default | davison
// Prints JSON as benchmarks/step_cost.py --peer reads it.
#include <mrpt/obs/CActionCollection.h>
#include <mrpt/obs/CActionRobotMovement2D.h>
#include <mrpt/obs/CObservationBearingRange.h>
#include <mrpt/obs/CSensoryFrame.h>
#include <mrpt/slam/CRangeBearingKFSLAM2D.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <vector>

using namespace mrpt::obs;

static CActionCollection::Ptr move(double x, double turn) {
    CActionRobotMovement2D action;
    CActionRobotMovement2D::TMotionModelOptions options;
    options.modelSelection = CActionRobotMovement2D::mmGaussian;
    action.computeFromOdometry(mrpt::poses::CPose2D(x, 0, turn), options);
    auto all = CActionCollection::Create();
    all->insert(action);
    return all;
}

static CSensoryFrame::Ptr look(const std::vector<std::pair<double, double>>& points, const std::vector<int>& ids,
                               double px, double py, double heading) {
    auto seen = CObservationBearingRange::Create();
    seen->sensor_std_range = 0.1f;
    seen->sensor_std_yaw = 0.02f;
    seen->maxSensorDistance = 1e4f;
    seen->fieldOfView_yaw = 6.2832f;
    for (int i : ids) {
        const double dx = points[i].first - px, dy = points[i].second - py;
        CObservationBearingRange::TMeasurement m;
        m.range = static_cast<float>(std::hypot(dx, dy));
        m.yaw = static_cast<float>(std::atan2(dy, dx) - heading);
        m.pitch = 0;
        m.landmarkID = i;
        seen->sensedData.push_back(m);
    }
    auto frame = CSensoryFrame::Create();
    frame->insert(seen);
    return frame;
}

static double measure(int n, bool davison) {
    mrpt::slam::CRangeBearingKFSLAM2D slam;
    slam.options.create_simplemap = false;
    slam.KF_options.verbosity_level = mrpt::system::LVL_ERROR;
    slam.setMinLoggingLevel(mrpt::system::LVL_ERROR);
    slam.KF_options.method = davison ? mrpt::bayes::kfEKFAlaDavison : mrpt::bayes::kfEKFNaive;
    const int side = static_cast<int>(std::ceil(std::sqrt(double(n))));
    std::vector<std::pair<double, double>> points;
    for (int i = 0; i < n; i++) points.push_back({2.0 * (i % side) - side, 2.0 * (i / side) - side + 0.7});
    for (int start = 0; start < n; start += 50) {
        std::vector<int> ids;
        for (int i = start; i < std::min(start + 50, n); i++) ids.push_back(i);
        auto action = move(0, 0);
        auto frame = look(points, ids, 0, 0, 0);
        slam.processActionObservation(action, frame);
    }
    std::vector<int> near(n);
    for (int i = 0; i < n; i++) near[i] = i;
    std::partial_sort(near.begin(), near.begin() + 10, near.end(), [&](int a, int b) {
        return std::hypot(points[a].first, points[a].second) < std::hypot(points[b].first, points[b].second);
    });
    near.resize(10);
    std::vector<double> ms;
    const int steps = n >= 500 ? 7 : 25;
    for (int k = 0; k < steps; k++) {
        auto action = move(0, 0);
        auto frame = look(points, near, 0, 0, 0);
        const auto begin = std::clock();  // CPU time: other processes do not count
        slam.processActionObservation(action, frame);
        ms.push_back(1e3 * double(std::clock() - begin) / CLOCKS_PER_SEC);
    }
    std::sort(ms.begin(), ms.end());
    return ms[ms.size() / 2];
}

int main(int argc, char** argv) {
    const bool davison = argc > 1 && !std::strcmp(argv[1], "davison");
    std::printf("{\"name\": \"MRPT EKF %s\", \"ms\": {", davison ? "Davison mode" : "default");
    for (int k = 2; k < argc; k++)
        std::printf("%s\"%s\": %.4f", k > 2 ? ", " : "", argv[k], measure(std::atoi(argv[k]), davison));
    std::printf("}}\n");
}
