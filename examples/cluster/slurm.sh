#!/bin/bash
# One grid as a SLURM array: each task takes one shard, in a journal of its own on the shared disk.
#   sbatch examples/cluster/slurm.sh benchmarks/full.toml out/full
# A task that is killed or times out is simply submitted again: it continues. When all are done:
#   tomthumb bench GRID.toml -o OUT --merge && tomthumb report OUT
#SBATCH --job-name=tomthumb
#SBATCH --array=1-16
#SBATCH --cpus-per-task=8
#SBATCH --mem-per-cpu=2G
#SBATCH --time=04:00:00
#SBATCH --requeue
set -euo pipefail
grid=${1:?GRID.toml}
out=${2:?folder for the journals}
exec tomthumb bench "$grid" -o "$out" \
  --shard "${SLURM_ARRAY_TASK_ID:?}/${SLURM_ARRAY_TASK_COUNT:?}" --workers "${SLURM_CPUS_PER_TASK:-1}"
