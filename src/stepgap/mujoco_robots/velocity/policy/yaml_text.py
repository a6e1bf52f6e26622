"""YAML in which trainings write what belongs to a policy: tables, lists, numbers and texts. Nothing in it is called."""

import re
from importlib import import_module
from typing import Any, Final

_EXPONENT: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")
"""A number such as 2e-2, which YAML 1.1 takes for a text."""


def parse_yaml(text: str) -> Any:
    """The value in a document of YAML; tags, such as those of Python objects, are passed over.

    Raises:
        ValueError: It is not YAML; the message is the reason in one line.
    """
    yaml: Any = import_module("yaml")  # of the extra `policy`

    class Loader(yaml.SafeLoader):
        """PyYAML's loader of plain values."""

    Loader.add_constructor(None, _without_tag)
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", _EXPONENT, [*"-+.0123456789"])
    try:
        return yaml.load(text, Loader)
    except RecursionError:
        raise ValueError("its lists or tables are nested too deeply") from None
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(" ".join(str(error).split())) from None


def _without_tag(loader: Any, node: Any) -> Any:
    if node.id == "mapping":
        return loader.construct_mapping(node, deep=True)
    return loader.construct_sequence(node, deep=True) if node.id == "sequence" else loader.construct_scalar(node)
