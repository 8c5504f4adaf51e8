"""`glissando study FILE.toml`: simulation and estimation over all combinations of settings."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from glissando.cli.console import Console
from glissando.cli.outputs import require_results_folder, stated
from glissando.cli.progress import working
from glissando.cli.shared import Commands, add_command
from glissando.errors import GlissandoError
from glissando.experiments.runner import cluster
from glissando.experiments.study.figures import study_figure
from glissando.experiments.study.plan import Cell, load_study
from glissando.experiments.study.store import TABLE, Store, run_cells
from glissando.experiments.study.summary import print_summary, summarise
from glissando.io.provenance import write_report
from glissando.visualization.canvas import save_figure

_HELP = """\
Simulate, estimate and check every combination of settings that a TOML file names, over many seeds,
on all cores or on a Dask cluster; one table of everything, and error and coverage by each axis.

FILE.toml has seeds = N, [grid] with lists of values to combine, and [fixed] with settings that all
share. Results are kept as they come: after whatever stopped it, the same command with --resume goes
on, and ends with the same table.
"""
_EXAMPLES = """\
examples:
  glissando study sweep.toml --out results
  glissando study sweep.toml --out results --resume      # goes on; --retry: failed cells, too
  glissando study sweep.toml --scheduler tcp://10.0.0.1:8786

exit status: 0 done; 1 some cells failed, the table says why; 2 something given was wrong.
"""


def add_to(commands: Commands) -> None:
    """Add this command, with its options, to the command line."""
    texts = _HELP, _EXAMPLES
    parser = add_command(commands, "study", texts, _study)
    add = parser.add_argument
    add("file", type=Path, metavar="FILE.toml", help="what to sweep")
    add("--scheduler", metavar="ADDRESS", help="of a Dask cluster (default: local processes)")
    add("--workers", type=int, metavar="N", help="local processes (default: one a core)")
    add("--resume", action="store_true", help="go on with what --out holds")
    add("--retry", action="store_true", help="the same, and run failed cells again")
    add("--out", type=Path, metavar="DIR", help="default: results/ and the name of FILE")
    add("--json", action="store_true", help="print one JSON object and nothing else")


def _study(options: argparse.Namespace) -> int:
    if options.workers is not None and (options.workers < 1 or options.scheduler):
        raise GlissandoError(
            f"--workers {options.workers} cannot be; give one or more, and no --scheduler."
        )
    study = load_study(options.file)
    cells = study.cells()
    folder = options.out or Path("results") / options.file.stem
    require_results_folder(folder)
    resume = options.resume or options.retry
    store = Store(study, folder, resume=resume)
    failed = {key for key, row in store.rows.items() if row["error"] is not None}
    kept = store.rows.keys() - (failed if options.retry else set())
    todo = [c for c in cells if c.id not in kept]
    if todo:
        _run(options, todo, store, f"{study.name}: {len(cells) - len(todo):,} kept, now")
    results = summarise(study, store.join(cells).to_pylist())
    summary = folder / "summary.json"
    write_report(summary, results | stated(options))
    written = folder / TABLE, summary, save_figure(study_figure(results), folder / "study.png")
    if options.json:
        print(json.dumps(results))
    else:
        print_summary(results, Console())
        Console().print("Wrote " + ", ".join(str(path) for path in written), markup=False)
    return 1 if results["failed"] else 0


def _run(options: argparse.Namespace, todo: list[Cell], store: Store, doing: str) -> None:
    with working(doing) as work, cluster(options.scheduler, options.workers) as client:

        def show(done: int, failed: int) -> None:
            note = f"{done:,} of {len(todo):,} cells" + (f", {failed} failed" if failed else "")
            work.update(done, len(todo), note)

        run_cells(client, todo, store, show)
