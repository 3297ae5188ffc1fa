"""Libraries that a base installation goes without, and the extras of pyproject.toml that install them.

Each is imported by the function that uses it, which asks `require_library` first, before anybody has waited.
"""

from importlib.util import find_spec

from bcid.errors import LibraryMissing

EXTRAS = {
    "torch": "networks", "deap": "checks", "filterpy": "checks", "pysindy": "checks",
    "casadi": "export", "fmpy": "export", "onnx": "export", "onnxruntime": "export",
    "distributed": "fleet",
}  # fmt: skip
"""The extra that installs each library: to train networks, check answers against others', export, or use a cluster."""


def is_installed(name: str) -> bool:
    """Whether the library `name` is installed; it is looked for and not imported."""
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def require_library(name: str, purpose: str) -> None:
    """Do nothing where the library `name`, one of `EXTRAS`, is installed; it is looked for and not imported.

    Raises:
        LibraryMissing: it is not installed; the message says that `purpose` needs it, and how to install it.
    """
    if not is_installed(name):
        raise library_missing(name, purpose)


def library_missing(name: str, purpose: str) -> LibraryMissing:
    """The error that `purpose` needs the library `name`, one of `EXTRAS`, with the command that installs it."""
    return LibraryMissing(
        f"{purpose} needs the library {name}, which is not installed\n  next: {install_command(name)}"
    )


def install_command(name: str) -> str:
    """The command that installs the library `name`, one of `EXTRAS`."""
    return f'pip install "bcid[{EXTRAS[name]}]"'
