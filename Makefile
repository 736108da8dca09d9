# Everything runs in .venv, which is made at the first use. PYTHON=... chooses the Python for it.
.DEFAULT_GOAL := help
.PHONY: help setup demo test test-other golden bench format generate clean
MAKEFLAGS += --no-print-directory

RUN := PATH="$(CURDIR)/.venv/bin:$$PATH"

help:  ## this list
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' Makefile

setup:  ## make .venv, or bring it up to date (the others do this by themselves)
	@PYTHON="$(PYTHON)" sh tools/setup.sh

demo: setup  ## simulate, navigate, report: ARGS="..." is handed on
	@$(RUN) python -m demo.run $(ARGS)

test: setup  ## lint, types, tests: ARGS="..." is handed on to pytest
	@$(RUN) ruff check
	@$(RUN) ruff format --check
	@$(RUN) mypy
	@$(RUN) lint-imports
	@$(RUN) python -m pytest -n 3 --dist loadgroup $(ARGS)

test-other: setup  ## the tests without ROS on the other supported Pythons that are installed
	@sh tools/test_other.sh $(ARGS)

golden: setup  ## renew the digests of test/golden: ARGS="vehicle faults" some of them
	@$(RUN) PYTHONPATH=test OPENBLAS_NUM_THREADS=1 python -m golden.replay $(ARGS)

bench: setup  ## measure accuracy and speed: ARGS="..." is handed on
	@$(RUN) python bench/run.py $(ARGS)

format: setup  ## format the code, repair what ruff can
	@$(RUN) ruff check --fix-only --quiet
	@$(RUN) ruff format

generate: setup  ## write config/ins.yaml and the tables of the documentation from the declarations
	@$(RUN) python -m ins_nav.cli.generate

clean:  ## remove .venv and everything that was built
	@rm -rf .venv .venv-* build install log *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +
