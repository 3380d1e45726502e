#!/bin/bash
# The same through Dask: one job runs the scheduler and the driver, an array runs workers that come and go.
#   sbatch examples/cluster/dask_on_slurm.sh benchmarks/full.toml out/full
#   sbatch --array=1-16 --cpus-per-task=8 --wrap 'dask worker --scheduler-file out/full/scheduler.json --nworkers 8 --nthreads 1'
#SBATCH --job-name=tomthumb-driver
#SBATCH --cpus-per-task=2
#SBATCH --time=08:00:00
#SBATCH --requeue
set -euo pipefail
grid=${1:?GRID.toml}
out=${2:?folder for journal and report}
mkdir -p "$out"
dask scheduler --host "$(hostname -f)" --port 8786 --scheduler-file "$out/scheduler.json" &
trap 'kill %1' EXIT
tomthumb bench "$grid" -o "$out" --dask "tcp://$(hostname -f):8786" --patience 28800 # the workers may wait in the queue
tomthumb report "$out"
