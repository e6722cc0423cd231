"""JavaScript as a syntax tree."""

import tree_sitter
import tree_sitter_javascript

FUNCTIONS = {
    "function_declaration",
    "function_expression",
    "generator_function",
    "generator_function_declaration",
    "arrow_function",
    "method_definition",
}


def parse(text):
    """Return the root node of a text."""
    language = tree_sitter.Language(tree_sitter_javascript.language())
    return tree_sitter.Parser(language).parse(text.encode()).root_node


def nodes(node):
    """Yield a node and all below it."""
    yield node
    for child in node.children:
        yield from nodes(child)


def imports(text):
    """Yield the places that a module imports from, as they are written."""
    for node in nodes(parse(text)):
        if node.type in ("import_statement", "export_statement"):
            source = node.child_by_field_name("source")
            if source is not None:
                yield source.text.decode().strip("\"'")


def functions(text):
    """Yield the name of each function, or its place, and its number of code lines."""
    root = parse(text)
    told = set()
    for node in nodes(root):
        if node.type == "comment":
            told.update(range(node.start_point[0] + 1, node.end_point[0]))
    lines = text.splitlines()
    for node in nodes(root):
        if node.type in FUNCTIONS:
            first, last = node.start_point[0], node.end_point[0]
            name = node.child_by_field_name("name") or node.parent.child_by_field_name("name")
            code = [
                k
                for k in range(first, last + 1)
                if lines[k].strip() and k not in told and not lines[k].strip().startswith("//")
            ]
            yield (name.text.decode() if name else f"line {first + 1}"), len(code)
