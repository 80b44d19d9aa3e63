"""Messages as YAML text, as ``ros2 topic echo`` prints them and ``ros2 topic pub --yaml-file`` reads them.

Written for readers of YAML 1.1, of which PyYAML (and with it ROS) is one: text always in quotes, numbers with
a decimal point and a signed exponent.

>>> print(yaml_text({"id": "a", "p": {"x": 1e-7}, "names": ["b"], "points": [{"t": 1}]}), end="")
id: "a"
p:
  x: 1.0e-07
names: ["b"]
points:
- t: 1
"""

from __future__ import annotations

import json
from typing import Any

TRUTHS = ("y", "n", "yes", "no", "on", "off")
"""Keys that YAML 1.1 takes for true and false; only some readers leave ``y`` alone."""


def yaml_documents(messages: list[dict[str, Any]], heading: str = "") -> str:
    """Several messages as one YAML stream, a document each.

    Args:
        messages: nested dictionaries and lists of numbers and text.
        heading: lines of comment at the beginning.
    """
    comment = "".join(f"# {line}\n" for line in heading.splitlines())
    return comment + "---\n".join(yaml_text(message) for message in messages)


def yaml_text(message: dict[str, Any], indent: str = "") -> str:
    """One message as a block mapping; lists of plain values stand on one line."""
    lines = []
    for name, content in message.items():
        key = f'"{name}"' if name in TRUTHS else name
        if isinstance(content, dict):
            lines.append(f"{indent}{key}:\n{yaml_text(content, indent + '  ')}")
        elif isinstance(content, list) and content and isinstance(content[0], dict):
            lines.append(f"{indent}{key}:\n")
            for item in content:
                body = yaml_text(item, indent + "  ")
                lines.append(f"{indent}- {body[len(indent) + 2 :]}")
        elif isinstance(content, list):
            lines.append(f"{indent}{key}: [{', '.join(map(_scalar, content))}]\n")
        else:
            lines.append(f"{indent}{key}: {_scalar(content)}\n")
    return "".join(lines)


def _scalar(content: Any) -> str:
    if isinstance(content, str):
        return json.dumps(content)  # every JSON string is a YAML one; ASCII with escapes
    if isinstance(content, float):
        text = repr(content)
        mantissa, exponent, power = text.partition("e")
        return text if "." in mantissa or not exponent else f"{mantissa}.0e{power}"
    return str(content)
