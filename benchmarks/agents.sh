#!/bin/sh
# Everything that docs/agents.md tells of, from nothing, into runs/agents; killed, it goes on where it was.
# About two hours on two processors. Give "quick" for a check of every step in minutes.
set -eu
cd "$(dirname "$0")/.."
out=runs/agents
run="${PYTHON:-.venv/bin/python} -m training.cli"
if [ "${1:-}" = quick ]; then
    out=runs/agents-quick lessons=60 steps=1 episodes=20 ablation=20 few=2 seeds=1
else
    lessons=2000 steps=3000000 episodes=500 ablation=300 few=30 seeds=3
fi

# the shipped agent, and its scores
$run train-agent --out $out/parking --odometry exact wheels --difficulty normal hard --lessons $lessons --steps $steps
$run ship-agent $out/parking/agent --out $out/shipped --episodes $episodes
[ "$out" = runs/agents ] && cp $out/parking/learning.png docs/images/learning.png
$run evaluate-agent --agent $out/shipped scripted --episodes $episodes --out $out/scores.json

# what credence is worth to an agent: alike but for that, with a sonar that is often wrong
${PYTHON:-.venv/bin/python} -c "
from noise import load_model, save_model
from noise.faults import Faulty, Noise, Short
save_model(Faulty(load_model('srf08-mlp'), [Short(0.15), Noise(0.15, 0.1)]), '$out/faulty')"
for seed in $(seq 0 $((seeds - 1))); do
    for told in credence no-credence; do
        $run train-agent --out $out/$told-$seed --$told --sonars $out/faulty --odometry wheels --seed "$seed" \
            --lessons $((lessons * 3 / 10)) --steps 0 --hidden 128 64 --num-envs 128
        $run evaluate-agent --agent $out/$told-$seed/agent --sonars $out/faulty --odometry wheels --episodes $ablation \
            --out $out/$told-$seed.json
    done
done

# which sonar to train with
$run transfer --out $out/transfer --seeds $seeds --lessons $((lessons / 4)) --episodes $few
