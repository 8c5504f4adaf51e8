"""Reading TOML files, with errors that name the file, the key and a remedy."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from glissando.errors import GlissandoError
from glissando.io.plain_file import plain_text
from glissando.model.table import Table


def read_toml(path: Path, error: type[GlissandoError]) -> Table:
    """Read a TOML file as a Table; raises `error` if it cannot be read or parsed."""
    return Table(read_document(path, error), path.name, error)


def read_document(path: Path, error: type[GlissandoError] = GlissandoError) -> dict[str, Any]:
    """Read a TOML file as a document; raises `error` if it cannot be read or parsed."""
    try:
        return tomllib.loads(plain_text(path))
    except OSError as problem:
        raise error(f"{path} cannot be read ({problem.strerror}); check the path.") from None
    except UnicodeDecodeError:
        raise error(f"{path} is not a text in UTF-8; save it as such.") from None
    except ValueError as problem:  # tomllib's own, or of an invalid number or date
        raise error(f"{path} is not valid TOML: {problem}. Correct that line.") from None
    except RecursionError:
        raise error(f"{path} nests tables or lists far too deep; write them flat.") from None
