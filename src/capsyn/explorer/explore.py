"""`explore`: a policy as one HTML file that needs nothing else."""

from __future__ import annotations

import base64
import hashlib
import html
import os
import re
from importlib import resources
from pathlib import Path

from capsyn.errors import ProblemError
from capsyn.execution.files import write_text
from capsyn.explorer.formulas import formulas
from capsyn.explorer.memory_data import needs_memory
from capsyn.explorer.packed import pack
from capsyn.explorer.page_data import page_data
from capsyn.explorer.program_javascript import features_javascript, model_javascript
from capsyn.policies.policy import Policy
from capsyn.validation import describe

POLICY = "default-src 'none'; script-src '{script}'; style-src '{style}'; {nothing}"
NOTHING = "base-uri 'none'; form-action 'none'"


def explore(policy: Policy, path: str | os.PathLike[str], drawing: str | None = None) -> Path:
    """Write the page of a policy: its map, closed loop, automaton and facts.

    The page is one file that opens from disk in any browser and needs no network. The same policy
    gives the same bytes. See ``docs/explorer.md``.

    Parameters
    ----------
    policy : Policy
        The policy or decision tree. Without a model, the page has no closed loop.
    path : path
        The file to write. A file that was there is replaced only by a complete page.
    drawing : "pendulum", "cart-pole", "double-tank" or "none", optional
        The animation of the system. Default: the animation of the built-in problem of the policy's
        name, if there is one.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    ProblemError
        An argument that cannot be used, or a place that cannot be written.
    """
    if not isinstance(policy, Policy):
        raise ProblemError(f"`policy` must be a capsyn.Policy; got {describe(policy)}")
    write_text(path, page(policy, drawing))
    return Path(path)


def page(policy: Policy, drawing: str | None = None) -> str:
    """Return the page of a policy as HTML."""
    bundle = "page.memory" if needs_memory(policy) else "page"
    style = _resource(f"{bundle}.css").strip()
    model = model_javascript(policy).removeprefix("export ").strip()
    notice = f"/* With uPlot:\n{_resource('vendor/uPlot.LICENSE').strip()} */"
    code = _resource(f"{bundle}.js").strip()
    features = features_javascript(policy).removeprefix("export ").strip()
    begin = f"await capsynPage.start(model{', features' if features else ''});"
    script = "\n".join(filter(None, [notice, model, features, code, begin]))
    parts = {
        "TITLE": html.escape(f"{policy.name} - capsyn"),
        "SECURITY": html.escape(
            POLICY.format(script=_digest(script), style=_digest(style), nothing=NOTHING)
        ),
        "FORMULAS": _formulas(policy),
        "DATA": pack(page_data(policy, drawing)),
        "STYLE": style,
        "SCRIPT": script,
    }
    # one pass: what is put in is never looked at again
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda mark: parts[mark[1]], _resource("page/page.html"))


def _formulas(policy: Policy) -> str:
    topics = formulas(policy).items()
    return "".join(f"<h3>{html.escape(topic)}</h3>{''.join(lines)}" for topic, lines in topics)


def _resource(name: str) -> str:
    return resources.files("capsyn.explorer").joinpath(name).read_text("utf-8")


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
