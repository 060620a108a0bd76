# `make demo` and `make test` do everything on a machine that has Python >= 3.11 with pip and venv, and make.

BIN := .venv/bin
STAMP := .venv/.installed
KERNEL := hatch_build.py $(wildcard src/commonlaw/kernel/*.[ch])
DOCS_STAMP := .venv/.docs-installed
BENCH_STAMP := .venv/.bench-installed
RELEASE_STAMP := .venv/.release-installed
TRIED := build/release
DEMO := demo
DEMO_RUN := commonlaw discover dataset:linear-drag:noise=0.05:seed=1 --order 2 \
	--save $(DEMO)/law.json --save $(DEMO)/law.png

RELEASE_RUN := bin/commonlaw discover dataset:linear-drag:noise=0.05:seed=1 --order 2 --method derivative-regression

# The kernels gain nothing from threads of their own, and lose much when the cores are busy.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
# Both names: the first pins build environments for older pips, the second for newer ones.
export PIP_CONSTRAINT := constraints.txt
export PIP_BUILD_CONSTRAINT := constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1

SUITABLE := import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))

.PHONY: help demo study layers pictures docs fuzz test lint types contracts unit slow bench bench-discovery scores bench-bound bench-coverage bench-fits bench-errors bench-universal bench-discrepancy bench-cluster bench-cost bench-growth bench-choice bench-confounding bench-next bench-unseen bench-symbolic bench-ratios bench-orders bench-trajectory bench-unmeasured release-check kernel clean
.DEFAULT_GOAL := help

help: ## List the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-16s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(STAMP) ## Find a law in simulated drops: equations beside the truth, and a picture in demo/
	mkdir -p $(DEMO)
	$(BIN)/$(DEMO_RUN)

study: $(STAMP) ## Redo the founding paper in report/: minutes; less with ARGS="--only simulated", and --help
	$(BIN)/python -m studies.falling_balls $(ARGS)

test: $(STAMP) ## Run every check
	$(MAKE) --no-print-directory -j 2 lint contracts
	$(MAKE) --no-print-directory -j 2 types unit

lint: $(STAMP) ## Style and format
	$(BIN)/ruff check
	$(BIN)/ruff format --check

types: $(STAMP) ## Types, strictly
	$(BIN)/mypy

kernel: $(STAMP) ## Build the compiled kernel again, after its C sources changed
	$(BIN)/python hatch_build.py

layers: $(STAMP) ## Draw docs/layers.svg from the import contract
	$(BIN)/python docs/layers.py

contracts: $(STAMP) ## Which room may import which
	$(BIN)/lint-imports

pictures: $(STAMP) ## Draw the pictures of the README and the documentation again: those of the app need Chromium
	$(BIN)/python docs/pictures.py
	$(BIN)/python docs/app_pictures.py

docs: $(DOCS_STAMP) ## Build the documentation in build/docs, with all its examples run: three minutes of CPU
	$(BIN)/python -m sphinx -q -W --keep-going -j 2 -b html -d build/doctrees docs build/docs
	$(BIN)/pytest -q tests/reference/built_docs.py

fuzz: $(STAMP) ## Run hostile cases of all kinds, tens of thousands: hours; less with ARGS="--cases 2000 --seed 7"
	$(BIN)/python -m tests.hostile.fuzz $(ARGS)
	KILLS=20 $(BIN)/pytest -q tests/hostile/test_kills.py

unit: $(STAMP) ## Tests and the examples in docstrings, with warnings as errors
	$(BIN)/pytest -n 2 --dist loadgroup --durations 20 -m "not slow"

slow: $(STAMP) ## Tests that take long, those of the whole study among them: half an hour
	$(BIN)/pytest -m slow

bench: $(BENCH_STAMP) ## Measure commonlaw beside PySINDy: about ten minutes
	$(BIN)/python -m benchmarks

bench-discovery: $(STAMP) ## Laws of a collection of problems, beside baselines: hours; less with ARGS="--noise 0.01"
	$(BIN)/python -m benchmarks.discovery $(ARGS)

scores: $(STAMP) ## Write the tables of scores of the README and the documentation; ARGS=FILE of bench-discovery --out FILE replaces them first
	$(BIN)/python -m benchmarks.published $(ARGS)

bench-bound: $(STAMP) ## Errors of coefficients over the Cramer-Rao bound: hours; less with ARGS="--draws 5"
	$(BIN)/python -m benchmarks.cramer_rao $(ARGS)

bench-coverage: $(STAMP) ## How often stated intervals hold the truth: an hour; less with ARGS="--draws 20"
	$(BIN)/python -m benchmarks.coverage $(ARGS)

bench-fits: $(STAMP) ## How often intervals of fits of 3 to 12 samples hold the truth: half an hour; less with ARGS="--draws 20"
	$(BIN)/python -m benchmarks.coverage_of_fits $(ARGS)

bench-errors: $(STAMP) ## Laws under other errors than white noise: half an hour; less with ARGS="--draws 5"
	$(BIN)/python -m benchmarks.error_models $(ARGS)

bench-universal: $(STAMP) ## What decides coefficients, and forecasts of unseen objects: half an hour; less with ARGS="--seeds 1"
	$(BIN)/python -m benchmarks.universal $(ARGS)

bench-discrepancy: $(STAMP) ## What laws leave unexplained: ten minutes; less with ARGS="--draws 20"
	$(BIN)/python -m benchmarks.discrepancy $(ARGS)

bench-choice: $(STAMP) ## Whether laws of small data are right as often as they say: ten minutes; less with ARGS="--draws 10"
	$(BIN)/python -m benchmarks.choice $(ARGS)

bench-confounding: $(STAMP) ## Whether confounded variables are reported: a minute; half an hour with ARGS="--laws"
	$(BIN)/python -m benchmarks.confounding $(ARGS)

bench-next: $(STAMP) ## Whether designed experiments find the law sooner than random ones: half an hour
	$(BIN)/python -m benchmarks.next_experiment $(ARGS)

bench-unseen: $(STAMP) ## Whether bounds of absent coefficients hold: a minute
	$(BIN)/python -m benchmarks.unseen $(ARGS)

bench-trajectory: $(STAMP) ## Laws of one trajectory with errors in proportion: an hour; less with ARGS="--only spring"
	$(BIN)/python -m benchmarks.one_trajectory $(ARGS)

bench-orders: $(STAMP) ## Whether a law is of first or of second order: twenty minutes; less with ARGS="--only relaxation"
	$(BIN)/python -m benchmarks.orders $(ARGS)

bench-unmeasured: $(STAMP) ## States that nobody measured: twenty minutes; less with ARGS="--seeds 2 --fits 2"
	$(BIN)/python -m benchmarks.unmeasured $(ARGS)

bench-symbolic: $(BENCH_STAMP) ## Laws that are no sums of fixed functions, beside symbolic regression: half an hour; less with ARGS="--seconds 5"
	$(BIN)/python -m benchmarks.symbolic $(ARGS)

bench-ratios: $(STAMP) ## Laws that are ratios of two sums, beside plain ones: ten minutes; less with ARGS="--draws 5"
	$(BIN)/python -m benchmarks.ratios $(ARGS)

bench-cluster: $(STAMP) ## What a second worker of a cluster saves: ten minutes; less with ARGS="--rows 1e6 --objects 200"
	$(BIN)/python -m benchmarks.cluster $(ARGS)

bench-growth: $(STAMP) ## How time and memory grow with samples, objects, terms and states: ten minutes; less with ARGS="--axis terms"
	$(BIN)/python -m benchmarks.growth $(ARGS)

bench-cost: $(STAMP) ## What a law with nothing given costs: minutes
	$(BIN)/python -m benchmarks.cost $(ARGS)

release-check: $(RELEASE_STAMP) ## Build wheel and sdist, check them, and find a law with each in an environment of its own: minutes
	rm -rf dist $(TRIED)
	$(BIN)/python -m build
	$(BIN)/python -m twine check --strict dist/*
	@version=$$($(BIN)/commonlaw --version); grep -qF "## [$${version##* }]" CHANGELOG.md || \
		{ echo "CHANGELOG.md has no part for $$version" >&2; exit 1; }
	@set -e; for built in dist/*; do \
		echo "trying $$built"; $(BIN)/python -m venv --clear $(TRIED); \
		$(TRIED)/bin/python -m pip install --quiet -c constraints.txt "$$built"; \
		$(TRIED)/bin/commonlaw --version; \
		$(TRIED)/$(RELEASE_RUN); \
	done
	@grep -n 'example\.org' pyproject.toml && echo "fill these addresses in before this is published" || true

clean: ## Remove the environment, caches and products
	rm -rf .venv build dist $(DEMO) report .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	rm -f src/commonlaw/kernel/kernel.so src/commonlaw/kernel/kernel.dll
	find src studies tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

$(STAMP): pyproject.toml constraints.txt $(KERNEL) | $(BIN)/python
	# pip would compile with one core, and tests of packages too
	$(BIN)/python -m pip install --quiet --no-compile -c constraints.txt -e '.[dev,all]'
	-$(BIN)/python -m compileall -qq -j 0 -x '/tests/' .venv/lib
	@touch $@

$(DOCS_STAMP): $(STAMP)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[docs]'
	@touch $@

$(RELEASE_STAMP): $(STAMP)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[release]'
	@touch $@

$(BENCH_STAMP): $(STAMP)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[bench]'
	@touch $@

$(BIN)/python:
	@python=; for each in $(PYTHON) python3.11 python3 python3.12 python3.13 python; do \
		if "$$each" -c '$(SUITABLE)' >/dev/null 2>&1; then python=$$each; break; fi; \
	done; \
	if [ -z "$$python" ]; then \
		echo "commonlaw needs Python 3.11 or newer with venv and pip, and found none:" \
			"install it, or name it, as in 'make test PYTHON=/path/to/python3.11'" >&2; exit 1; \
	fi; \
	echo "$$python -m venv .venv"; "$$python" -m venv .venv
