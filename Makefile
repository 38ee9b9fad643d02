# Each target does all its own set-up; after the first run nothing needs the network.
PYTHON ?= python3
BIN := .venv/bin
MINUTES ?= 10
CASES ?=
PACKAGE ?=
SEED ?=
READY := .venv/.ready
EVERYTHING := .venv/.everything
SKIPPED := .venv/skipped-tests.txt
# one process of them has the tests of nodes, which wait most of their time
LANES := -n 3 --dist loadfile --no-loadscope-reorder
PACKAGES := lftkit titop_plant los_estimator fsm_pma_controller los_loop los_design pointing_analysis
COMPILE := uv pip compile --quiet --universal --python-version 3.10 --generate-hashes --no-header --no-annotate \
    --override overrides.txt --no-emit-package lftkit --no-emit-package pointing-analysis
export OPENBLAS_NUM_THREADS ?= 1
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# hundreds of processes start in the tests: without bytecode each of them compiles the packages anew
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help run test tests test-further test-anywhere test-slow fuzz attacks forgeries faults lint style types types-of-tests stages paper paper-designs reference-bag report-picture image-pictures campaign-pictures bench docs designs site lock release clean

help:
	@echo "make run        10 s of the closed loop on ROS 2: table, bag, report"
	@echo "make test       style, types, tests of some 10 minutes; at the end what was skipped and how to get it"
	@echo "make test PACKAGE=los_loop  the unit tests of one package alone"
	@echo "make test-further  more whole programs, foreign nodes and damage; CI has them, a quarter of an hour"
	@echo "make test-anywhere  those that other machines could fail: tests/elsewhere.py makes such"
	@echo "make test-slow  the long ones"
	@echo "make fuzz MINUTES=10  random damaged and forged bags, files and command lines"
	@echo "make attacks MINUTES=10  runs beside random foreign nodes on their domain; CASES=200: so many instead"
	@echo "make forgeries MINUTES=10  files of proofs that are forged, and whether anything false is said"
	@echo "make faults MINUTES=10  runs with signals, full disks, too little memory ..., and what is left of them"
	@echo "                SEED=N repeats what one of these four has found: they print it"
	@echo "make stages     the four stages of control side by side"
	@echo "make paper      figures and tables of docs/paper.md: the paper's own problem, from the stored designs"
	@echo "make paper-designs  its four designs anew, in examples/paper/designs (most of an hour, resumable)"
	@echo "make reference-bag  the small bag under bags/reference anew"
	@echo "make report-picture  docs/figures/report.png anew (needs chromium)"
	@echo "make image-pictures  docs/figures/star.png and target.png anew"
	@echo "make campaign-pictures  those of docs/campaigns.md and docs/your_spacecraft.md (needs chromium; some minutes)"
	@echo "make bench      benchmarks with short settings, one JSON object each"
	@echo "make docs       figures and tables of README.md and docs/results.md from the model and the stored designs"
	@echo "make designs    the shipped controllers of the implemented loop anew (a quarter of an hour or more)"
	@echo "make site       build/site: the documentation with its API reference, links checked"
	@echo "make lint       style and types alone"
	@echo "make lock       the locks of environment/ anew (needs the network)"
	@echo "make release    dist/: wheels and sdists, tried in an empty environment; then the tag (needs the network)"
	@echo "make clean      remove everything that was made, except bags"

$(READY): environment/run.lock environment/uv.lock pyproject.toml lftkit/pyproject.toml pointing_analysis/pyproject.toml
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(None if (3, 10) <= v <= (3, 13) else \
	    "expected Python 3.10 to 3.13, $(PYTHON) is %d.%d: name another, for example make run PYTHON=python3.12" % v)'
	@echo "environment: .venv"
	@$(PYTHON) -m venv .venv
	@$(BIN)/python environment/install.py run
	@touch $(READY)

$(EVERYTHING): $(READY) environment/everything.lock
	@$(BIN)/python environment/install.py everything
	@touch $(EVERYTHING)

run: $(READY)
	$(BIN)/los-testbed run --domain free

lint: $(EVERYTHING)
	@$(MAKE) --no-print-directory --jobs 2 --output-sync=target types types-of-tests style

style: $(EVERYTHING)
	$(BESIDE) $(BIN)/ruff check .
	$(BESIDE) $(BIN)/ruff format --check .
	$(BESIDE) $(BIN)/lint-imports --no-logo

types: $(EVERYTHING)
	$(BESIDE) $(BIN)/mypy

# after those of the packages, whose cache it reads
types-of-tests: types
	$(BESIDE) $(BIN)/mypy --config-file tests/mypy.ini tests

# style and types have the priority of the tests that start no nodes, see tests/support/lanes.py
test: $(EVERYTHING)
	@$(MAKE) --no-print-directory --jobs 4 BESIDE="nice -n 3" tests $(if $(PACKAGE),,style types types-of-tests) \
	    || { echo "Something failed, see above; style and types alone: make lint"; exit 1; }

tests: $(EVERYTHING)
	@rm -f $(SKIPPED)
	SKIPPED_TESTS_FILE=$(SKIPPED) $(BIN)/pytest $(LANES) -m "not slow and not further" --doctest-modules \
	    $(if $(PACKAGE),tests/unit/$(PACKAGE) $(filter $(PACKAGE),$(PACKAGES)),tests $(PACKAGES))
	@if [ -s $(SKIPPED) ]; then echo "Skipped tests and what was not judged, and how to run them:"; cat $(SKIPPED); \
	    else echo "No test was skipped."; fi

test-further: $(EVERYTHING)
	$(BIN)/pytest $(LANES) -m "further and not slow" tests

# tests/elsewhere.py starts it on machines of other kinds
test-anywhere: $(EVERYTHING)
	$(BIN)/pytest $(LANES) -m "not slow" $$($(BIN)/python tests/support/anywhere.py)

test-slow: $(EVERYTHING)
	$(BIN)/pytest -m slow tests

fuzz: $(EVERYTHING)
	$(BIN)/python tests/fuzz/fuzz_for.py $(MINUTES) $(SEED:%=--seed=%)

attacks: $(EVERYTHING)
	PYTHONPATH=tests $(BIN)/python tests/support/attack_campaign.py $(or $(CASES:%=--cases=%),--minutes=$(MINUTES)) $(SEED:%=--seed=%)

forgeries: $(EVERYTHING)
	$(BIN)/python tests/fuzz/forge_proofs.py --minutes=$(MINUTES) $(SEED:%=--seed=%)

faults: $(EVERYTHING)
	PYTHONPATH=tests $(BIN)/python tests/fuzz/fault_campaign.py $(MINUTES) $(SEED)

paper-designs: $(READY)
	$(BIN)/python examples/paper/designs.py --only nominal & $(BIN)/python examples/paper/designs.py --only robust && wait $$!

paper: $(READY)
	$(BIN)/python examples/paper/all.py docs/figures/paper
	for table in paper_gammas paper_decades paper_reduction; do \
	    $(BIN)/python docs/fill_tables.py $$table < docs/figures/paper/results.json || exit 1; done
	$(BIN)/python docs/fill_tables.py paper_orders < examples/paper/orders.json

stages: $(READY)
	$(BIN)/los-testbed stages

reference-bag: $(READY)
	rm -rf build/reference
	$(BIN)/los-testbed run --mode inprocess --duration 4.1 --seed 1 --output build/reference --no-report
	rm -rf bags/reference && mv build/reference bags/reference

report-picture: $(EVERYTHING)
	rm -rf build/stages
	$(BIN)/los-testbed stages --scenario worst_case --output build/stages
	$(BIN)/python docs/report_picture.py build/stages/report-worst_case.html docs/figures/report.png

image-pictures: $(EVERYTHING)
	rm -rf build/image
	for stage in none isolator fsm fsm+pma; do $(BIN)/los-testbed run --mode inprocess --duration 4 --loop $$stage \
	    --scenario worst_case --no-report --output build/image/$$stage || exit 1; done
	$(BIN)/los-testbed image figures build/image/none build/image/isolator build/image/fsm build/image/fsm+pma \
	    --output build/image/pictures
	cp build/image/pictures/star.png build/image/pictures/target.png docs/figures/

campaign-pictures: $(EVERYTHING)
	rm -rf build/campaign build/spin_up
	$(BIN)/los-testbed campaign --samples 500 --output build/campaign
	$(BIN)/python docs/report_picture.py build/campaign/report.html docs/figures/campaign.png .pictures
	$(BIN)/los-testbed stages --case spin_up --no-parts --output build/spin_up
	$(BIN)/python docs/report_picture.py build/spin_up/report-ramp.html docs/figures/spin_up_error.png '#rpe-over-time'
	$(BIN)/python docs/report_picture.py build/spin_up/report-ramp.html docs/figures/spin_up_waterfall.png '#waterfall-2'
	$(BIN)/python docs/report_picture.py build/spin_up/report-ramp.html docs/figures/spin_up_campbell.png '#campbell-2'

bench: $(EVERYTHING)
	$(BIN)/python benchmarks/frequency_response.py --samples 2 --json
	$(BIN)/python benchmarks/hinf_norm.py --samples 8 --json
	$(BIN)/python benchmarks/verification.py --points 8 --json
	$(BIN)/python benchmarks/campaign.py --members 3 --json
	$(BIN)/python benchmarks/tick.py --json
	$(BIN)/python benchmarks/size.py --states 100,204 --json
	$(BIN)/python benchmarks/goals.py --json
	$(BIN)/python benchmarks/tuning.py --plants AC4,PSM --seconds 10 --json
	$(BIN)/python benchmarks/bag_reading.py --seconds 10 --json
	$(BIN)/python benchmarks/image_quality.py --json
	$(BIN)/python benchmarks/flight_code.py --steps 1e5 --json
	$(BIN)/python benchmarks/real_time_loop.py --seconds 10 --json
	$(BIN)/python benchmarks/image_camera.py --pairs 1 --seconds 5 --json
	$(BIN)/python benchmarks/lockstep.py --seconds 5 --json
	$(BIN)/python benchmarks/deadline_qos.py --seconds 4 --json
	$(BIN)/python benchmarks/soak.py --minutes 2 --json

docs: $(EVERYTHING)
	$(BIN)/los-testbed plant figures --output docs/figures
	$(BIN)/los-testbed design figures --output docs/figures
	$(BIN)/los-testbed design table --json | $(BIN)/python docs/fill_tables.py gammas
	folder=$$(mktemp -d) && $(BIN)/los-testbed stages --output $$folder/stages \
	    && $(BIN)/python docs/fill_tables.py stages < $$folder/stages/stages.md \
	    && $(BIN)/python docs/fill_tables.py worst_case < $$folder/stages/stages.md \
	    && COLUMNS=100 $(BIN)/los-testbed run --mode inprocess --output $$folder/run > $$folder/run.txt \
	    && $(BIN)/python docs/fill_tables.py run < $$folder/run.txt && rm -r $$folder

designs: $(EVERYTHING)
	$(BIN)/los-testbed design all --output build/designs
	cp build/designs/k_fsm.json los_estimator/designs/
	cp build/designs/k_pma.json fsm_pma_controller/designs/
	cp build/designs/worst_points.json los_design/search/
	$(BIN)/los-testbed design all --nominal --effort short --output build/designs_nominal || true
	cp build/designs_nominal/k_fsm.json los_estimator/designs/k_fsm_implemented_nominal.json
	cp build/designs_nominal/k_pma.json fsm_pma_controller/designs/k_pma_implemented_nominal.json

site: $(EVERYTHING)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	$(BIN)/python docs/site/check_links.py build/site

# the same versions in both: those of a run are held at those of everything
lock:
	$(PYTHON) -m venv .venv-lock && .venv-lock/bin/pip install --quiet --require-hashes --no-deps -r environment/uv.lock
	cd environment && ../.venv-lock/bin/$(COMPILE) --all-extras ../pyproject.toml -o everything.lock
	cd environment && ../.venv-lock/bin/$(COMPILE) --extra ros --extra fast --extra live -c everything.lock \
	    ../pyproject.toml build.txt -o run.lock

release: $(EVERYTHING)
	$(BIN)/python environment/release.py

clean:
	rm -rf dist .venv .venv-lock .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis build *.egg-info lftkit/build lftkit/*.egg-info pointing_analysis/build pointing_analysis/*.egg-info
	rm -rf ros_ws/build ros_ws/install ros_ws/log
