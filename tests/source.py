"""What the tests of the rooms, and benchmarks/structure.py, read of the source of a package."""

import ast


def files_of(package):
    """{room.file: path} of the files of a package."""
    return {".".join(path.relative_to(package).with_suffix("").parts): path for path in sorted(package.rglob("*.py"))}


def imports(name, tree, files):
    """Files of the package that a file imports, those inside functions and for annotations alone too."""
    folder, found = name.split(".")[:-1], set()
    for node in ast.walk(tree):
        if not isinstance(node, ast.ImportFrom) or not node.level:
            continue
        base = ".".join(folder[: len(folder) - node.level + 1] + ([node.module] if node.module else []))
        for alias in node.names:
            whole = f"{base}.{alias.name}".strip(".")
            found |= {target for target in (whole, base) if target in files and target != name}
    return found


def functions(tree):
    """All functions, those in classes and in functions too."""
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def is_kernel(node):
    """Whether numba compiles a function."""
    return any("njit" in ast.unparse(decorator) for decorator in node.decorator_list)


def lines(node):
    """Of a function from its name on."""
    return node.end_lineno - node.lineno + 1


def taken(node):
    """The arguments of a function, of every kind."""
    given = node.args
    return [*given.posonlyargs, *given.args, *given.kwonlyargs, *filter(None, (given.vararg, given.kwarg))]


def not_annotated(node):
    """Names of the arguments of a function that say no type, and `return` where it does not say that."""
    bare = [a.arg for a in taken(node) if a.annotation is None and a.arg not in ("self", "cls")]
    return bare + ["return"] * (node.returns is None and node.name != "__init__")
