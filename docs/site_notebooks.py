"""Pages of notebooks as they are committed: text, code, what it printed, and pictures."""

import base64
import json

# Kinds of outputs that are shown, the best first.
PICTURE, TEXT = "image/png", "text/plain"


def pages(folder, stage):
    """Markdown of all notebooks of a folder by paths; pictures are written beside them, in `stage`."""
    found = {}
    for path in sorted(folder.glob("*.ipynb")):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        place = stage / folder.name
        parts = [cell for number, one in enumerate(cells) for cell in texts(one, f"{path.stem}-{number}", place)]
        found[f"{folder.name}/{path.stem}.md"] = "\n\n".join(parts) + "\n"
    return found


def texts(cell, name, place):
    """Parts of a page that a cell makes."""
    source = "".join(cell["source"])
    if cell["cell_type"] != "code":
        yield source
        return
    yield f"```python\n{source}\n```"
    for number, output in enumerate(cell["outputs"]):
        data = output.get("data", {})
        if PICTURE in data:
            place.mkdir(parents=True, exist_ok=True)
            file = f"{name}-{number}.png"
            (place / file).write_bytes(base64.b64decode("".join(data[PICTURE])))
            yield f"![]({file})"
        else:
            said = "".join(output.get("text", data.get(TEXT, [])))
            if said.strip():
                yield f"```text\n{said.rstrip()}\n```"
