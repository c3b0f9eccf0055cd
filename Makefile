# What there is to do with this project; needs Python 3.11 or newer, make and git.

PYTHON ?= python3
BIN = .venv/bin
STAMP = .venv/.installed
DEMO = build/demo
MAPS = build/maps
LOGS = drive.csv drive.log drive.bag drive_ros2 drive.mcap

.PHONY: help demo maps test bench bench-scale fuzz docs gallery clean

help: ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-11s  %s\n", $$1, $$2 }' Makefile

demo: $(STAMP) ## Build a map of a simulated drive
	@mkdir -p $(DEMO)
	@$(BIN)/occmap build sample_logs/drive.mcap -o $(DEMO)/map.pgm -o $(DEMO)/map.png
	@echo "Look at $(DEMO)/map.png; map_server and nav2 load $(DEMO)/map.yaml"

maps: $(STAMP) ## Build a map of each sample log: five formats, one map, and a hall in 3D
	@mkdir -p $(MAPS)
	@for log in $(LOGS); do \
		$(BIN)/occmap build -q sample_logs/$$log -o $(MAPS)/$$log.pgm || exit; \
		cmp $(MAPS)/drive.csv.pgm $(MAPS)/$$log.pgm || exit; \
	done
	@$(BIN)/occmap build -q sample_logs/hall.mcap -o $(MAPS)/hall.mcap.pgm
	@echo "$(MAPS) holds the maps of $(LOGS), all the same, byte for byte, and of hall.mcap"

test: $(STAMP) ## Check style and types, and run all tests
	@$(BIN)/ruff check --quiet .
	@$(BIN)/ruff format --quiet --check .
	@$(BIN)/python -m occmap.cli.warm & $(BIN)/mypy && wait $$!
	@$(BIN)/pytest -q -n 2 --dist worksteal

bench: $(STAMP) ## Measure how fast maps are built
	@$(BIN)/python -m tests.bench

bench-scale: $(STAMP) ## Measure what a build by many workers costs
	@$(BIN)/python -m tests.bench.scale

fuzz: $(STAMP) ## Feed the readers damaged logs, a minute each
	@$(BIN)/python -m tests.fuzz

docs: $(STAMP) ## Make the docs a site, and check its links
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	@rm -rf build/pages && mkdir -p build/pages/sample_logs
	@cp -R README.md CHANGELOG.md CONTRIBUTING.md LICENSE docs build/pages
	@cp sample_logs/map.png build/pages/sample_logs
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict --config-file .github/mkdocs.yml
	@echo "Look at build/site/index.html"

gallery: $(STAMP) ## Make the pictures of docs/gallery.md anew
	@rm -rf build/gallery && mkdir -p build/gallery && ln -s ../../sample_logs build/gallery
	@awk '/^```/ { on = /sh$$/; next } on' docs/gallery.md > build/gallery/commands
	@cd build/gallery && PATH="$(CURDIR)/$(BIN):$$PATH" sh -e commands > log 2>&1 && cp *.png ../../docs/pictures

clean: ## Remove what was built, and the virtual environment
	@rm -rf build dist .venv .mypy_cache .pytest_cache .ruff_cache .hypothesis
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit("occmap needs Python 3.11 or newer, this is %d.%d: try make PYTHON=python3.12" % sys.version_info[:2] if sys.version_info < (3, 11) else 0)'
	@echo "Setting up .venv (once)"
	@$(PYTHON) -m venv .venv
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --editable ".[dev]"
	@$(BIN)/python -m compileall -q -j 0 -x '/(tests|devtools|mypyc?)/' .venv/lib occmap
	@touch $(STAMP)
