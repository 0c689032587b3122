#!/bin/sh
# Reproduce the results of docs/explanation/agents.md in runs/agents. To continue after an interruption, give the same command again.
# Two jobs run in parallel, about 90 minutes on two processors. With the argument "quick", check every step in minutes.
set -eu
cd "$(dirname "$0")/.."
out=runs/agents
python="${PYTHON:-.venv/bin/python}"
run="$python -m training.cli"
if [ "${1:-}" = quick ]; then
    out=runs/agents-quick lessons=60 steps=1 episodes=20 ablation=20 streets=2 seeds=1
else
    lessons=3000 steps=1000000 episodes=500 ablation=300 streets=30 seeds=3
fi
mkdir -p $out
shipped="--odometry exact wheels --difficulty normal hard --lessons $lessons"

# the shipped agent, the same agent with PPO, and their scores
shipped_agent() {
    $run train-agent --out $out/parking $shipped
    [ -d $out/quick ] || { cp -r $out/parking $out/quick.part && mv $out/quick.part $out/quick; }
    $run train-agent --out $out/quick $shipped --steps $steps
    [ -d $out/shipped/parking ] || $run ship-agent $out/parking/agent --out $out/shipped/parking --episodes $episodes
    drivers="$out/shipped/parking $out/quick/agent scripted"
    $run evaluate-agent --agent $drivers --episodes $episodes --out $out/scores.json
    $run evaluate-agent --agent $drivers --sonars rig --believed srf08-mlp --episodes $((episodes * 2 / 5)) --out $out/rig.json
}

# agents with and without credence, with a faulty sonar; then agents trained with several sonars
comparisons() {
    $python -c "
from noise import load_model, save_model
from noise.faults import Faulty, Noise, Short
save_model(Faulty(load_model('srf08-mlp'), [Short(0.15), Noise(0.15, 0.1)]), '$out/faulty')"
    for seed in $(seq 0 $((seeds - 1))); do
        for arm in credence no-credence; do
            $run train-agent --out $out/$arm-$seed --$arm --sonars $out/faulty --no-faults --odometry wheels --seed "$seed" \
                --lessons $((lessons / 5)) --hidden 128 64 --num-envs 128
            $run evaluate-agent --agent $out/$arm-$seed/agent --sonars $out/faulty --odometry wheels --episodes $ablation \
                --out $out/$arm-$seed.json
        done
    done
    $run transfer --out $out/transfer --seeds $seeds --lessons $((lessons / 6)) --episodes $streets --workers 1
}

echo "to follow: tail -f $out/shipped_agent.log $out/comparisons.log"
shipped_agent > $out/shipped_agent.log 2>&1 &
first=$!
comparisons > $out/comparisons.log 2>&1 &  # not under "||", which would disable `set -e` inside the function
second=$!
wait $second || { kill $first; tail $out/comparisons.log; exit 1; }
wait $first || { tail $out/shipped_agent.log; exit 1; }
cat $out/shipped_agent.log $out/comparisons.log
