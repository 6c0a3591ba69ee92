"""notebook.py NOTEBOOK: runs all cells of the notebook of the Python client."""

import sys

import nbclient
import nbformat

notebook = nbformat.read(sys.argv[1], 4)
nbclient.NotebookClient(notebook, timeout=600).execute()
pictures = [o for cell in notebook.cells for o in cell.get("outputs", []) if "image/png" in o.get("data", {})]
assert len(pictures) == 3, f"the notebook shows {len(pictures)} figures, not 3"
print("all cells of the notebook ran")
