#!/bin/sh
# Everything that docs/agents.md tells of, from nothing, into runs/agents; killed, it goes on where it was.
# Two things at a time, about an hour and a half on two processors. Give "quick" for a check of every step in minutes.
set -eu
cd "$(dirname "$0")/.."
out=runs/agents
python="${PYTHON:-.venv/bin/python}"
run="$python -m training.cli"
if [ "${1:-}" = quick ]; then
    out=runs/agents-quick lessons=60 steps=1 episodes=20 ablation=20 few=2 seeds=1
else
    lessons=3000 steps=1000000 episodes=500 ablation=300 few=30 seeds=3
fi
mkdir -p $out
shipped="--odometry exact wheels --difficulty normal hard --lessons $lessons"

# the shipped agent, the same taught by trial to be quicker, and their scores
one() {
    $run train-agent --out $out/parking $shipped
    [ -d $out/quick ] || { cp -r $out/parking $out/quick.part && mv $out/quick.part $out/quick; }
    $run train-agent --out $out/quick $shipped --steps $steps
    [ -d $out/shipped/parking ] || $run ship-agent $out/parking/agent --out $out/shipped/parking --episodes $episodes
    drivers="$out/shipped/parking $out/quick/agent scripted"
    $run evaluate-agent --agent $drivers --episodes $episodes --out $out/scores.json
    $run evaluate-agent --agent $drivers --sonars rig --believed srf08-mlp --episodes $((episodes * 2 / 5)) --out $out/rig.json
}

# what credence is worth to an agent: alike but for that, with a sonar that is often wrong; then which sonar to train with
two() {
    $python -c "
from noise import load_model, save_model
from noise.faults import Faulty, Noise, Short
save_model(Faulty(load_model('srf08-mlp'), [Short(0.15), Noise(0.15, 0.1)]), '$out/faulty')"
    for seed in $(seq 0 $((seeds - 1))); do
        for told in credence no-credence; do
            $run train-agent --out $out/$told-$seed --$told --sonars $out/faulty --no-faults --odometry wheels --seed "$seed" \
                --lessons $((lessons / 5)) --hidden 128 64 --num-envs 128
            $run evaluate-agent --agent $out/$told-$seed/agent --sonars $out/faulty --odometry wheels --episodes $ablation \
                --out $out/$told-$seed.json
        done
    done
    $run transfer --out $out/transfer --seeds $seeds --lessons $((lessons / 6)) --episodes $few --workers 1
}

echo "to look on: tail -f $out/one.log $out/two.log"
one > $out/one.log 2>&1 &
first=$!
two > $out/two.log 2>&1 &  # beside it and not under "||", where the shell would go on after whatever fails
second=$!
wait $second || { kill $first; tail $out/two.log; exit 1; }
wait $first || { tail $out/one.log; exit 1; }
cat $out/one.log $out/two.log
