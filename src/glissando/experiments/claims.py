"""Claims of the paper: each with its number, our number and a verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from glissando.errors import GlissandoError
from glissando.io.toml_table import read_toml
from glissando.model.table import Table

CLAIMS = Path(__file__).parent / "claims.toml"
_DIRECTIONS = ("below", "above", "report")


class ClaimsError(GlissandoError):
    """A file of claims is invalid, or needs a number that is not computed."""


@dataclass(frozen=True)
class Claim:
    """One claim: its sentence, the paper's number, and how ours is computed and judged.

    Attributes:
        id: Name of the claim.
        says: The claim in a sentence.
        paper: The paper's number, as text.
        ours: Format string over the results, `{table[C][fixed][position][value]:.3f}`.
        direction: 'below' or 'above' for the side of the bound on which the claim holds; 'report'
            for a number that is not judged.
        measure: Dotted path in the results of the number that is judged.
        bound: Bound with which the number is compared.
        beyond: Whether the claim goes beyond the paper.
        full: Whether a quick run leaves the claim out.
        effect: Dotted path of an interval that is compared with `paper_effect`; empty for none.
        paper_effect: The paper's value of the effect.
    """

    id: str
    says: str
    paper: str
    ours: str
    direction: str
    measure: str = ""
    bound: float = 0.0
    beyond: bool = False
    full: bool = False
    effect: str = ""
    paper_effect: float = 0.0


@dataclass(frozen=True)
class Verdict:
    """A claim with our number and a verdict: 'holds', 'FAILS', or '' if it is not judged.

    `size` compares the effect with the paper's in words, if the paper gives one.
    """

    claim: Claim
    ours: str
    value: float | None
    verdict: str
    size: str = ""

    @property
    def fails(self) -> bool:
        """Whether the claim was judged and does not hold."""
        return self.verdict == "FAILS"


def load_claims(path: Path = CLAIMS) -> list[Claim]:
    """Read the claims of a TOML file. Raises ClaimsError naming the claim and the key."""
    table = read_toml(path, ClaimsError)
    claims = [_claim(entry) for entry in table.tables("claims")]
    table.close()
    if not claims:
        raise ClaimsError(f"{path.name} holds no [[claims]]; add some.")
    return claims


def _claim(entry: Table) -> Claim:
    name = entry.text("id")
    entry.where = f"{entry.where} {name!r}"
    direction = entry.text("direction", choices=_DIRECTIONS)
    judged = direction != "report"
    claim = Claim(
        id=name,
        says=entry.text("says"),
        paper=entry.text("paper", "–"),
        ours=entry.text("ours"),
        direction=direction,
        measure=entry.text("measure") if judged else "",
        bound=entry.number("bound", positive=False) if judged else 0.0,
        beyond=entry.flag("beyond"),
        full=entry.flag("full"),
        effect=entry.text("effect", ""),
        paper_effect=entry.number("paper_effect", 0.0, positive=False),
    )
    entry.close()
    return claim


def judge(claims: Sequence[Claim], results: dict[str, Any]) -> list[Verdict]:
    """Judge every claim by our results. Raises ClaimsError for a number that is not computed."""
    return [_judge(claim, results) for claim in claims]


def _judge(claim: Claim, results: dict[str, Any]) -> Verdict:
    try:
        ours = claim.ours.format_map(results)
        size = _size(_at(results, claim.effect), claim.paper_effect) if claim.effect else ""
        if claim.direction == "report":
            return Verdict(claim, ours, None, "", size)
        value = float(_at(results, claim.measure))
    except (AttributeError, KeyError, TypeError, ValueError, IndexError) as problem:
        raise ClaimsError(
            f"Claim {claim.id!r} asks for a number that was not computed ({problem}); correct its "
            f"ours or measure."
        ) from None
    holds = value < claim.bound if claim.direction == "below" else value > claim.bound
    return Verdict(claim, ours, value, "holds" if holds else "FAILS", size)


def _at(results: Any, path: str) -> Any:
    """Entry of nested tables at a dotted path."""
    for key in path.split("."):
        results = results[key]
    return results


def _size(effect: dict[str, float], paper: float) -> str:
    """Size of an effect, given with its interval, relative to the paper's, in words."""
    if effect["low"] <= paper <= effect["high"]:
        return "as large as the paper's"
    return f"{effect['value'] / paper:.1f} × the paper's"
