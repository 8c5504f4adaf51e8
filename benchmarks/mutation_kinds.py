"""Damage to files and messages: of bytes, of text and numbers, of names, keys and shapes."""

import copy
import json
import tomllib

import tomli_w

NUMBERS = [
    *("0", "-1", "1e308", "-1e308", "1e-308", "nan", "inf", "1e9", "-0.0", "1e-9", "3", "1e400"),
    *("", "x", "true", "[]", "9223372036854775808", "4294967296", "-9223372036854775809"),
]
NAMES = [
    *("../x", "/tmp/x", "..", ".", "a/b", "a\\b", "\x00", "a\nb", "[/x]", "[frames]", "", " "),
    *("<script>alert(1)</script>", "</script><img src=x onerror=alert(1)>", "=1+1", "$HOME"),
    *("con", ".hidden", "n" * 300, "é" * 90, "\u202egnp.exe", "world", "tracker", "\udcff"),
]
VALUES = [
    *(None, True, [], {}, "", "x", -1, 0, 1 << 40, 1 << 63, -(1 << 64), 1e308, -1e-308, 0.5),
    *(float("nan"), float("inf"), [1, 2], [[1], [2]], {"a": 1}, "../x", "2020-01-01"),
]
SIZES = (1, 2, 4, 8)


def pick(rng, choices):
    """Random element of a sequence, without conversion."""
    return choices[int(rng.integers(len(choices)))]


def mutated_number(rng, text):
    """Replacement for a number: another number, or a text that is not a number."""
    if rng.random() < 0.5:
        return pick(rng, NUMBERS)
    try:
        return repr(float(text) * 10.0 ** float(rng.integers(-6, 7)) * pick(rng, [1.0, -1.0]))
    except (ValueError, OverflowError):
        return pick(rng, NUMBERS)


def mutated_bytes(rng, data):
    """Bytes with some changed, deleted, doubled, inserted, or overwritten by an integer."""
    out = bytearray(data)
    for _ in range(rng.integers(1, 8)):
        at, few = int(rng.integers(len(out) + 1)), int(rng.integers(1, 40))
        kind = rng.integers(7)
        if kind <= 1 and at < len(out):
            out[at] = int(rng.integers(256))
        elif kind == 2:
            del out[at : at + few]
        elif kind == 3:
            out[at:at] = out[at : at + few]
        elif kind == 4:
            out[at:at] = rng.bytes(few)
        elif kind == 5:
            size, order = pick(rng, SIZES), pick(rng, ("little", "big"))
            number = pick(rng, [0, 1, 1 << 31, (1 << 31) - 1, 1 << 24, -1, -2, 1 << 16])
            out[at : at + size] = (number % (1 << 8 * size)).to_bytes(size, order)
        elif rng.random() < 0.3:
            del out[at:]
    return bytes(out)


def mutated_table(rng, text, delimiter=","):
    """Delimited text with cells, columns or lines damaged."""
    lines = text.splitlines()
    for _ in range(rng.integers(1, 4)):
        if not lines:
            break
        kind, at = rng.integers(9), int(rng.integers(len(lines)))
        if rng.random() < 0.3:
            at = int(rng.integers(min(len(lines), 6)))  # in the header
        cells = lines[at].split(delimiter)
        column = int(rng.integers(len(cells)))
        if kind <= 2:
            cells[column] = mutated_number(rng, cells[column])
            lines[at] = delimiter.join(cells)
        elif kind == 3:
            _scale_column(rng, lines, column, delimiter)
        elif kind == 4:
            lines = lines[:at] + lines[at + int(rng.integers(1, len(lines) + 1)) :]
        elif kind == 5:
            lines[at:at] = lines[at : at + int(rng.integers(1, 20))]
        elif kind == 6:
            rng.shuffle(cells)
            lines[at] = delimiter.join(cells)
        elif kind == 7:
            cells[column] = pick(rng, NAMES)
            lines[at] = delimiter.join(cells)
        else:
            lines[at] = lines[at] + delimiter * int(rng.integers(1, 3000))
    return "\n".join(lines) + "\n"


def _scale_column(rng, lines, column, delimiter):
    """Scale a whole column, as if in another unit."""
    factor = pick(rng, [1e3, 1e-3, 1e6, -1.0, 57.3, 0.0, 1e200])
    for k in range(1, len(lines)):
        parts = lines[k].split(delimiter)
        try:
            parts[column] = repr(float(parts[column]) * factor)
        except (ValueError, IndexError):
            continue
        lines[k] = delimiter.join(parts)


def mutated_toml(rng, text):
    """TOML file with damaged numbers, keys or lines, or with a damaged tree."""
    if rng.random() < 0.5:
        return _mutated_lines(rng, text)
    tree = mutated_tree(rng, tomllib.loads(text))
    try:
        return tomli_w.dumps(_without_none(tree))
    except (TypeError, ValueError, RecursionError):
        return _mutated_lines(rng, text)


def _mutated_lines(rng, text):
    lines = text.splitlines()
    for _ in range(rng.integers(1, 3)):
        at, kind = int(rng.integers(len(lines))), rng.integers(6)
        key, equals, value = lines[at].partition("=")
        if kind <= 2 and equals:
            parts = value.strip().strip("[]").split(",")
            k = int(rng.integers(len(parts)))
            parts[k] = mutated_number(rng, parts[k].strip())
            inner = ", ".join(parts)
            lines[at] = f"{key}= [{inner}]" if "[" in value else f"{key}= {inner}"
        elif kind == 3:
            del lines[at]
        elif kind == 4 and equals:
            lines[at] = f"{key}= {'[' * 3000}{']' * 3000}"
        else:
            lines.insert(int(rng.integers(len(lines) + 1)), lines[at])
        if not lines:
            break
    return "\n".join(lines) + "\n"


def _without_none(tree):
    if isinstance(tree, dict):
        return {k: _without_none(v) for k, v in tree.items() if v is not None}
    if isinstance(tree, list):
        return [_without_none(v) for v in tree if v is not None]
    return tree


def mutated_tree(rng, tree):
    """Tree of dicts and lists with some values replaced, keys renamed, entries removed."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.integers(1, 4)):
        places = list(_places(tree))
        if not places:
            break
        holder, key = pick(rng, places)
        kind = rng.integers(6)
        value = holder[key]
        if kind == 0:
            del holder[key]
        elif kind == 1 and isinstance(holder, dict):
            holder[pick(rng, NAMES)] = holder.pop(key)
        elif kind == 2 and isinstance(value, str):
            holder[key] = pick(rng, NAMES)
        elif kind <= 3 and isinstance(value, int | float):
            holder[key] = float(value) * 10.0 ** float(rng.integers(-9, 10)) * pick(rng, [1, -1])
        elif kind == 4 and isinstance(value, list):
            holder[key] = value * 2 if rng.random() < 0.5 else value[:-1]
        else:
            holder[key] = copy.deepcopy(pick(rng, VALUES))
    return tree


def _places(tree):
    """Yield every container and key below a tree."""
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
        yield tree, key
        if isinstance(tree[key], dict | list):
            yield from _places(tree[key])


def mutated_json(rng, data):
    """JSON with a damaged tree, damaged bytes, or deep nesting."""
    if rng.random() < 0.1:
        return b"[" * 100_000 if rng.random() < 0.5 else b'{"a":' * 100_000
    if rng.random() < 0.3:
        return mutated_bytes(rng, data)
    return json.dumps(mutated_tree(rng, json.loads(data))).encode()


def mutated_file(rng, name, data):
    """File damaged by the method for its suffix."""
    suffix = name.rpartition(".")[2]
    if rng.random() < 0.1 or suffix not in ("csv", "toml", "json", "tsv", "yaml"):
        return mutated_bytes(rng, data)
    if suffix == "json":
        return mutated_json(rng, data)
    text = data.decode()
    if suffix == "toml":
        return mutated_toml(rng, text).encode(errors="surrogateescape")
    delimiter = {"tsv": "\t", "yaml": " "}.get(suffix, ",")
    return mutated_table(rng, text, delimiter).encode(errors="surrogateescape")
