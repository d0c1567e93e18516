# Every target sets up what it needs in .venv by itself. `make help` lists them.
VENV := .venv/bin
SHELL := /bin/bash

help: ## this list
	@grep -E '^[a-z-]+:.*##' Makefile | sed 's/:.*## /\t/' | expand -t 16

setup: ## make or mend .venv
	@tools/setup.sh

bake: setup ## bake the sample Cornell box into out/
	@mkdir -p out
	$(VENV)/radiosity bake sample_scenes/cornell_box.blend -o out/cornell_box.blend --picture out/cornell_box.png --report out/cornell_box.json

test: setup ## all tests but the heavy ones, and those that click in a real Blender
	$(VENV)/pytest

test-heavy: setup ## the heavy tests
	$(VENV)/pytest -m heavy

hard-cases: setup ## run the hard cases, large ones too, and write their table
	$(VENV)/python tests/hard_cases/write_table.py --heavy

test-blender: setup extension ## tests inside a real Blender: make test-blender BLENDER=path
	BLENDER="$(BLENDER)" $(VENV)/pytest -m blender

test-versions: setup ## the tests that know Blender, in the modules of Blender 4.2, 4.5 and 5.2, each in its own environment
	$(VENV)/python tools/versions.py $(VERSIONS)

extension: setup ## build dist/*.zip for every platform
	$(VENV)/python tools/extension.py

cells-plot: setup ## the figures of README's section "Cells" anew, into docs/
	@mkdir -p out
	for n in 973 1608; do $(VENV)/radiosity cells sample_scenes/paper_$$n.blend --max-patch mesh --rows analytic --error 1% --quiet --report out/cells_$$n.json --plot docs/cells_$$n.png || exit 1; done
	$(VENV)/radiosity cells sample_scenes/hall.blend --schedule dynamic --error 0.1% --quiet --report out/cells_hall.json --plot docs/cells_hall.png

price-plot: setup ## README's figure of error against seconds anew, into docs/
	@mkdir -p out
	$(VENV)/radiosity price sample_scenes/cornell_box.blend --error 1% --measure --reference tests/references/cornell_box.npz --report out/price.json --plot docs/price.png

bench: setup ## how fast bakes are, with Cycles beside them: figures, tables and plots into docs/bench/
	$(VENV)/python -m tools.bench $(BENCH)

bench-cells: setup ## how two cells scale, and the replay beside processes that sleep
	$(VENV)/python tools/bench_cells.py

samples: setup ## make the sample scenes anew (needs bpy 4.2)
	$(VENV)/python sample_scenes/make.py

effects-table: setup ## the README's table of effects: small scenes, as needed and with all forced
	$(VENV)/python tools/effects_table.py

lint: setup ## check the style
	$(VENV)/ruff check . && $(VENV)/ruff format --check .

.PHONY: help setup bake test test-heavy hard-cases test-blender extension samples effects-table lint cells-plot price-plot bench bench-cells test-versions
