"""The page of results says what is measured."""

import re
from pathlib import Path

import pytest

import results
import sorosim

ROOT = Path(__file__).parents[2]


def test_five_arclength_nodes_give_the_posterior_of_sixty_five():
    """A rod of 0.70 m bent to 2 rad/m, base known, a coil read once at the tip."""
    std = {nodes: results.bent_rod_std(nodes) for nodes in (5, 9, 17, 33, 65)}
    print("exact transitions, mid-length standard deviation (mm):", std)
    assert std[65] == pytest.approx(12.68, abs=0.01)
    for nodes in (5, 9, 17, 33):
        assert std[nodes] == pytest.approx(std[65], rel=1e-3)


@pytest.mark.slow
def test_numbers_of_the_results_page_are_what_the_code_prints(spacetime):
    """All but the timings, which a page can only date."""
    page = (ROOT / "docs" / "results.md").read_text()
    for label, run, published, _ in results.runs(spacetime):
        for line in results.accuracy(label, run, published):
            assert stands_in(page, line)
    for part in results.grid_lines().values():
        assert part in page
    assert stands_in(page, sorosim.line(spacetime.parent / "sorosim" / sorosim.FILE.name))


def stands_in(page, line):
    """Whether a page has a line, but for one in a number's last digit, which machines round."""
    number = r"\d+\.\d+"
    words, found = re.split(number, line), re.findall(number, line)
    for other in page.splitlines():
        if re.split(number, other) == words:
            pairs = zip(found, re.findall(number, other), strict=True)
            units = [abs(float(a) - float(b)) * 10 ** len(a.split(".")[1]) for a, b in pairs]
            if max(units, default=0.0) < 1.5:
                return True
    return False
