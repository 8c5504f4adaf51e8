"""What a page carries, decoded as the browser decodes it."""

import base64
import json
import re

import numpy as np

OUTSIDE = re.compile(r"https?:|\bsrc=\"(?!data:)|\bhref=|@import|\burl\(|\bimport\(|\bfetch\(")


def unpacked(entry):
    """The obvious decoder."""
    whole = np.frombuffer(base64.b64decode(entry["data"]), dtype="<u2").astype(float)
    values = np.where(whole == 65535, np.nan, entry["low"] + entry["step"] * whole)
    return values.reshape(entry["shape"])


def carried(html):
    """The scene that a page carries."""
    (text,) = re.findall(r'<script type="application/json" id="scene">(.*?)</script>', html)
    return json.loads(text)
