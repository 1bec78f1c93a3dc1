"""Executes a notebook, and writes it with its pictures into a folder: notebook.py NOTEBOOK FOLDER."""

import base64
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

source, folder = map(Path, sys.argv[1:])
notebook = nbformat.read(source, as_version=4)
NotebookClient(notebook, timeout=1800, kernel_name="python3").execute()
nbformat.write(notebook, folder / source.name)
pictures = 0
for number, cell in enumerate(notebook.cells):
    for output in cell.get("outputs", []):
        if picture := output.get("data", {}).get("image/png"):
            (folder / f"{source.stem}-{number}.png").write_bytes(base64.b64decode(picture))
            pictures += 1
print(f"{source.name}: {len(notebook.cells)} cells, {pictures} pictures, in {folder}")
