"""The description of an FMU: ``modelDescription.xml`` of FMI 2.0."""

from __future__ import annotations

import io
from xml.etree.ElementTree import Element
from xml.sax.saxutils import XMLGenerator
from xml.sax.xmlreader import AttributesImpl

from capsyn.exports.fmu.times import times_of, variable_names
from capsyn.exports.plan import Plan
from capsyn.exports.text import kind, spoken
from capsyn.modelling.time_unit import from_seconds
from capsyn.version import __version__


def description(plan: Plan, name: str, guid: str) -> bytes:
    """Return the description of a unit of a name."""
    variables = [*_states(plan), *_controls(plan), *_own(plan)]
    units = sorted({unit for (kind,) in variables if (unit := kind.get("unit"))})
    definitions = _element("UnitDefinitions", {}, *(_unit(plan, unit) for unit in units))
    abilities = dict(
        modelIdentifier=name,
        canHandleVariableCommunicationStepSize="true",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    sources = _element("SourceFiles", {}, Element("File", name=f"{name}.c"))
    root = _element(
        "fmiModelDescription",
        dict(
            fmiVersion="2.0",
            modelName=plan.policy.name or name,
            guid=guid,
            description=" ".join(plan.header),
            version=plan.sha256[:16],
            generationTool=f"capsyn {__version__}",
            variableNamingConvention="flat",
        ),
        _in_lines(_element("CoSimulation", abilities, sources)),
        _in_lines(definitions),
        _in_lines(_element("ModelVariables", {}, *variables)),
        _structure(plan),
    )
    return _text(_in_lines(root)).encode()


def _states(plan: Plan) -> list[Element]:
    """Return the inputs of the unit: readings of the states, then of exogenous inputs."""
    domain, names = plan.policy.space, variable_names(plan)
    variables = []
    for i in range(domain.n):
        what, unit = f"{kind(plan.policy, i)} {domain.names[i]}", domain.units[i]
        about = what[0].upper() + what[1:]
        if plan.folded:
            about = (
                f"Reading of which {what} [{unit}] is "
                f"reading * {float(plan.scale[i])!r} + {float(plan.offset[i])!r}"
            )
            unit = ""
        real = _real(unit, start="0")
        variables.append(_variable(names[i], i, "input", "continuous", real, about))
    return variables


def _controls(plan: Plan) -> list[Element]:
    n, alphabet, names = plan.n, plan.policy.alphabet, variable_names(plan)
    return [
        _variable(names[k], k, "output", "discrete", _real(unit), f"Control {input_name}")
        for k, (input_name, unit) in enumerate(zip(alphabet.inputs, alphabet.units), n)
    ]


def _own(plan: Plan) -> list[Element]:
    """Return the variables of every unit, and its parameters."""
    symbols = ", ".join(f"{k}: {text}" for k, text in enumerate(plan.symbol_names))
    statuses = "0: the state is in the domain, 1: outside, 2: a component is NaN or infinite"
    statuses = spoken(plan.policy, statuses)
    times, first = times_of(plan), plan.n + plan.policy.alphabet.m
    reals = [_real("s", start=repr(s), min="0", **_display(plan)) for s in times.seconds]
    names = variable_names(plan)[first:]
    return [
        _variable("symbol", 0, "output", "discrete", Element("Integer"), f"Symbol; {symbols}"),
        _variable("status", 1, "output", "discrete", Element("Integer"), statuses),
        *(
            _variable(name, place, "parameter", "fixed", real, about)
            for place, (name, real, about) in enumerate(zip(names, reals, times.about), first)
        ),
    ]


def _display(plan: Plan) -> dict[str, str]:
    """Return the attributes by which a time in seconds is displayed in another unit, if it is."""
    unit = plan.policy.time_unit
    return {} if unit == "s" else {"displayUnit": unit}


def _unit(plan: Plan, name: str) -> Element:
    """Return a unit; that of time says how to display the model's own."""
    unit = plan.policy.time_unit
    if name != "s" or unit == "s":
        return Element("Unit", name=name)
    factor = repr(from_seconds(1.0, unit))
    shown = Element("DisplayUnit", name=unit, factor=factor)
    return _element("Unit", {"name": "s"}, Element("BaseUnit", s="1"), shown)


def _structure(plan: Plan) -> Element:
    """Return which outputs depend on which inputs: all on all."""
    inputs = " ".join(str(i + 1) for i in range(plan.n))
    outputs = range(plan.n, plan.n + plan.policy.alphabet.m + 2)

    def unknowns(tag: str) -> Element:
        each = (Element("Unknown", index=str(k + 1), dependencies=inputs) for k in outputs)
        return _element(tag, {}, *each)

    return _element("ModelStructure", {}, unknowns("Outputs"), unknowns("InitialUnknowns"))


def _variable(
    name: str, reference: int, causality: str, variability: str, kind: Element, about: str
) -> Element:
    attributes = dict(name=name, valueReference=str(reference), description=about)
    attributes |= dict(causality=causality, variability=variability)
    return _element("ScalarVariable", attributes, kind)


def _real(unit: str, **attributes: str) -> Element:
    return Element("Real", attributes | ({"unit": unit} if unit else {}))


def _element(tag: str, attributes: dict[str, str], *children: Element) -> Element:
    element = Element(tag, attributes)
    element.extend(children)
    return element


def _in_lines(element: Element) -> Element:
    """Return an element whose children stand in a line each."""
    element.text = "\n"
    for child in element:
        child.tail = "\n"
    return element


def _text(root: Element) -> str:
    """Return the document, which `ElementTree` itself would write with other quotes and blanks."""
    text = io.StringIO()
    writer = XMLGenerator(text, "UTF-8", short_empty_elements=True)

    def write(element: Element) -> None:
        writer.startElement(element.tag, AttributesImpl(element.attrib))
        writer.characters(element.text or "")
        for child in element:
            write(child)
        writer.endElement(element.tag)
        writer.characters(element.tail or "")

    root.tail = "\n"
    writer.startDocument()
    write(root)
    return text.getvalue().replace("<Real/>", "<Real />")  # so that units keep their bytes
