# Two commands matter: `make demo` and `make test`. Both set up .venv on their first run and reuse it afterwards.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
TRIALS ?= 10
WORKERS ?= 2
FUZZ_SECONDS ?= 600
EXAMPLES ?= 20
ANNOUNCED := benchmarks/records/proof/announced.txt

NETWORKS := $(foreach gain,14 31,benchmarks/records/thesis-networks-$(gain).tar.xz)
SEEDS_14 := 5
SEEDS_31 := 3
RECORDS := $(addprefix docs/images/,cross-talk.json calibration.json fidelity.json highway.json curves.json) \
	docs/explanation/images/noise-credence.json $(NETWORKS)

URL ?=  # of the project, for the site and the release

.PHONY: help demo test docs figures release check audit fuzz install benchmarks judge proof firmware clean
.DEFAULT_GOAL := help

help:  ## list the targets
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## /  make \1\t/' | expand -t 20

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; v=sys.version_info[:2]; sys.exit(0 if (3,11)<=v<=(3,13) else f"sonar_gym needs Python 3.11 to 3.13, this is {v[0]}.{v[1]}: run make PYTHON=python3.11 ...")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

install: $(STAMP)  ## create .venv and install pinned versions

demo: $(STAMP)  ## record, diagnose, correct and drive; leaves demo/report.html and demo/parking.gif
	$(BIN)/sonar-gym demo --out demo

test: $(STAMP) check  ## lint, types, import contracts, and every test that is not slow
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile -q

docs: $(STAMP)  ## the site in site/; a broken link or any other warning is an error
	NO_MKDOCS_2_WARNING=1 SONAR_GYM_URL=$(URL) $(BIN)/mkdocs build --quiet

figures: $(STAMP) $(RECORDS)  ## make all pictures of the docs again, those of experiments from their records (ten minutes; hours where a record is missing)
	$(BIN)/sonar-gym effects --out docs/reference/effects
	$(BIN)/sonar-gym demo --out demo && cp demo/parking.gif docs/images/parking.gif
	$(BIN)/python examples/record_gif.py docs/images/parking.png srf08-mlp
	$(BIN)/python -m benchmarks.redraw
	rm -rf runs/figures && mkdir -p runs/figures
	for archive in $(NETWORKS); do tar -xJf $$archive -C runs/figures || exit 1; done  # networks that exist are not trained again
	$(BIN)/sonar-gym record --driver rig --plan thesis --gain 14 --seed 1 --out runs/figures/14.csv
	$(BIN)/sonar-gym compare-optimizers runs/figures/14.csv --out runs/figures/14 --seeds $(SEEDS_14) && cp runs/figures/14/*.png docs/explanation/thesis
	$(BIN)/sonar-gym record --driver rig --plan thesis --gain 31 --seed 1 --out runs/figures/31.csv
	$(BIN)/sonar-gym compare-optimizers runs/figures/31.csv --out runs/figures/31 --seeds $(SEEDS_31) && cp runs/figures/31/*.png docs/explanation/thesis/gain-31
	$(BIN)/sonar-gym record --driver rig --plan thesis --gain 11 --range-register 139 --out runs/figures/thesis.csv
	$(BIN)/sonar-gym plot runs/figures/thesis.csv --out runs/figures/thesis
	cp runs/figures/thesis/credence-plane.png docs/images/credence-plane.png
	$(BIN)/sonar-gym record --driver rig --plan vertical --gain 31 --out runs/figures/vertical.csv
	$(BIN)/sonar-gym plot runs/figures/vertical.csv --bearing pitch_deg --out runs/figures/vertical
	cp runs/figures/vertical/credence-polar.png docs/images/vertical.png
	for book in docs/tutorials/*.ipynb; do folder=$$(mktemp -d) && cp $$book $$folder \
		&& PATH=$(CURDIR)/$(BIN):$$PATH env -u MPLBACKEND TTY_COMPATIBLE=0 $(BIN)/jupyter nbconvert --to notebook --execute --inplace \
		--CoalesceStreamsPreprocessor.enabled=True --ExecutePreprocessor.record_timing=False $$folder/*.ipynb \
		&& cp $$folder/*.ipynb docs/tutorials || exit 1; done

# records of experiments: those that are missing are measured, which takes minutes to hours
docs/images/cross-talk.json: | $(STAMP)
	$(BIN)/python -m benchmarks.crosstalk
docs/images/calibration.json docs/images/fidelity.json: docs/images/%.json: | $(STAMP)
	$(BIN)/python -m benchmarks.$*
docs/images/highway.json: | $(STAMP)
	$(BIN)/python -c "from examples.train_highway import main; main(path='docs/images/highway.png')"
docs/images/curves.json: | $(STAMP)
	for k in 0 1 2 3 4 5 6 7 8 9; do for sonar in ideal srf08-mlp; do \
		$(BIN)/sonar-gym zoo ppo --env SonarParking-v0 --sonar $$sonar --seed $$k --out runs/curves/$$sonar/$$k || exit 1; done; done
	$(BIN)/sonar-gym zoo ppo --env SonarParkingManoeuvre-v0 --steps 4571136 --out runs/curves/manoeuvre
	$(BIN)/sonar-gym zoo sac --env SonarParkingGoal-v0 --out runs/curves/sac
	$(BIN)/python -m benchmarks.curves "PPO, ideal=runs/curves/ideal/*" "PPO, srf08-mlp=runs/curves/srf08-mlp/*" \
		"PPO, manoeuvre=runs/curves/manoeuvre" "SAC with hindsight=runs/curves/sac"
docs/explanation/images/noise-credence.json: | $(STAMP)
	$(BIN)/sonar-gym noise-report
$(NETWORKS): benchmarks/records/thesis-networks-%.tar.xz: | $(STAMP)
	mkdir -p runs/thesis
	test -f runs/thesis/$*.csv || $(BIN)/sonar-gym record --driver rig --plan thesis --gain $* --seed 1 --out runs/thesis/$*.csv
	$(BIN)/sonar-gym compare-optimizers runs/thesis/$*.csv --out runs/thesis/$* --seeds $(SEEDS_$*)
	tar -cJf $@ -C runs/thesis $*/networks

release: $(STAMP)  ## check what a release needs: make release VERSION=0.2.0
	PYTHON=$(BIN)/python .ci/release $(VERSION)

check: $(STAMP)  ## lint, types, import contracts, and known vulnerabilities where the package index lists them
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy
	$(BIN)/python .ci/audit

audit: $(STAMP)  ## known vulnerabilities of the pinned dependencies (needs the network), and their licences
	$(BIN)/python .ci/audit
	$(BIN)/pip-licenses --format markdown --order license

fuzz: $(STAMP)  ## ten minutes of bad files, options and values; a failure prints what repeats it
	@end=$$(( $$(date +%s) + $(FUZZ_SECONDS) )); while [ $$(date +%s) -lt $$end ]; do \
		SONAR_GYM_FUZZ=$(EXAMPLES) $(BIN)/python -m pytest tests/fuzz -n 2 -q --hypothesis-seed=$$(date +%s) || exit 1; done

benchmarks: $(STAMP)  ## performance figures, as ratios measured in one run
	$(BIN)/python -m pytest benchmarks -m '' -q -s

judge: $(STAMP)  ## measure the diagnosis on labelled trials (hours; stop at any time, the same command goes on)
	$(BIN)/sonar-gym judge --out runs/judge --n $(TRIALS) --workers $(WORKERS) --page docs/explanation/diagnosis-judged.md

proof: $(STAMP)  ## 300 blind trials (hours; stop at any time, the same command goes on)
	$(BIN)/sonar-gym prove --out runs/proof --trials 300 --workers $(WORKERS) --announce $(ANNOUNCED) --pages docs/explanation
	$(BIN)/sonar-gym verify-proof runs/proof/ledger.jsonl --workers $(WORKERS)
	$(BIN)/python -m benchmarks.first_design runs/proof/ledger.jsonl --workers $(WORKERS)
	$(BIN)/sonar-gym prove --out runs/proof --trials 300 --pages docs/explanation
	cp runs/proof/first-design.jsonl $(dir $(ANNOUNCED))
	xz -9 --keep --stdout runs/proof/ledger.jsonl > $(dir $(ANNOUNCED))ledger.jsonl.xz
	cp runs/proof/proof-families.md $(dir $(ANNOUNCED))

firmware:  ## compile the Arduino sketch; needs apt install gcc-avr avr-libc arduino-core-avr
	@command -v avr-g++ >/dev/null || { echo 'no avr-g++: apt install gcc-avr avr-libc arduino-core-avr'; exit 1; }
	$(MAKE) -s -C acquisition/firmware BUILD=$(CURDIR)/build/firmware

clean:  ## remove what was made, the environment included
	rm -rf $(VENV) demo runs build dist site *.egg-info
