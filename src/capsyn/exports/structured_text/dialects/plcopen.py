"""Units as PLCopen XML, TC6 version 2.01, which many tools import."""

from __future__ import annotations

import io
from collections.abc import Iterable
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from capsyn.exports.structured_text.pou import Pou, Variable
from capsyn.version import __version__

NAMESPACE = "http://www.plcopen.org/xml/tc6_0201"
XHTML = "http://www.w3.org/1999/xhtml"


def project(name: str, header: Iterable[str], units: Iterable[Pou]) -> bytes:
    """Return a project of units, without dates, so that the same units give the same bytes."""
    root = Element("project", xmlns=NAMESPACE)
    product = dict(companyName="capsyn", productName="capsyn", productVersion=__version__)
    SubElement(root, "fileHeader", product, creationDateTime="1970-01-01T00:00:00")
    content = SubElement(root, "contentHeader", name=name)
    coordinates = SubElement(content, "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        SubElement(SubElement(coordinates, language), "scaling", x="1", y="1")
    types = SubElement(root, "types")
    SubElement(types, "dataTypes")
    pous = SubElement(types, "pous")
    for unit in units:
        about = [*(header if unit.name == name else []), *unit.about]
        _unit(SubElement(pous, "pou", name=unit.name), unit, about)
    SubElement(SubElement(root, "instances"), "configurations")
    file = io.BytesIO()
    ElementTree.indent(root)
    tree = ElementTree.ElementTree(root)
    tree.write(file, encoding="utf-8", xml_declaration=True)
    return file.getvalue() + b"\n"


def _unit(pou: Element, unit: Pou, about: list[str]) -> None:
    pou.set("pouType", "function" if unit.result else "functionBlock")
    interface = SubElement(pou, "interface")
    if unit.result:
        SubElement(SubElement(interface, "returnType"), unit.result)
    lists = (("inputVars", unit.inputs), ("outputVars", unit.outputs), ("localVars", unit.inner))
    for kind, variables in lists:
        if variables:
            parent = SubElement(interface, kind)
            for variable in variables:
                _variable(SubElement(parent, "variable", name=variable.name), variable)
    _text(SubElement(SubElement(pou, "body"), "ST"), unit.body)
    if about:
        _text(SubElement(pou, "documentation"), about)


def _variable(element: Element, variable: Variable) -> None:
    kind = SubElement(element, "type")
    if variable.size:
        kind = SubElement(kind, "array")
        SubElement(kind, "dimension", lower="0", upper=str(variable.size - 1))
        kind = SubElement(kind, "baseType")
    SubElement(kind, variable.kind)
    if variable.values:
        array = SubElement(SubElement(element, "initialValue"), "arrayValue")
        for value in variable.values:
            SubElement(SubElement(array, "value"), "simpleValue", value=value)
    elif variable.start:
        SubElement(SubElement(element, "initialValue"), "simpleValue", value=variable.start)
    if variable.about:
        _text(SubElement(element, "documentation"), [variable.about])


def _text(parent: Element, lines: Iterable[str]) -> None:
    SubElement(parent, "p", xmlns=XHTML).text = "\n".join(lines)
