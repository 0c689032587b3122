#!/bin/sh
# Reproduce the results of docs/explanation/agents.md in runs/agents. To continue after an interruption, give the same command again.
# Two jobs run in parallel, about two hours on two processors. With the argument "quick", check every step in minutes.
set -eu
cd "$(dirname "$0")/.."
out=runs/agents
python="${PYTHON:-.venv/bin/python}"
run="$python -m training.cli"
if [ "${1:-}" = quick ]; then
    out=runs/agents-quick lessons=60 steps=1 episodes=20 ablation=2 agents=2 streets=2 seeds=2
else
    lessons=3000 steps=1000000 episodes=500 ablation=32 agents=10 streets=30 seeds=10
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

# agents with and without credence and echo flags; then agents trained with several sonars
comparisons() {
    $run compare-observations --out $out/observations --agents $agents --lessons $((lessons / 5)) --streets $ablation --workers 1
    $run transfer --out $out/transfer --learners imitation --seeds $seeds --lessons $((lessons / 6)) --episodes $streets --workers 1
}

echo "to follow: tail -f $out/shipped_agent.log $out/comparisons.log"
shipped_agent > $out/shipped_agent.log 2>&1 &
first=$!
comparisons > $out/comparisons.log 2>&1 &  # not under "||", which would disable `set -e` inside the function
second=$!
wait $second || { kill $first; tail $out/comparisons.log; exit 1; }
wait $first || { tail $out/shipped_agent.log; exit 1; }
cat $out/shipped_agent.log $out/comparisons.log
