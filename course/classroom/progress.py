"""The progress page, `make progress`: what the checks in the working copies said, as they were last
saved.

Its links open the notebooks in the JupyterLab that `make lab` has started, whose addresses reach no
single cell. Once the student's functions make a method, `mine/omnistereo.py`, it is run on a frame,
and its error and time stand beside the library's. Where every function is right, it ends with a
certificate: the panorama that notebook 06 computed by the student's own.
"""

import html
import itertools
import re
from pathlib import Path

from jupyter_server.serverapp import list_running_servers

from course import exercises, nbtools
from course.classroom import table
from course.classroom.lab import WORKING
from course.exercises import mine
from omnistereo_lib.files import write_text

PICTURE = '"06 repaired"'  # the name of the figure that the certificate shows
SAID = re.compile(r"^\x1b\[\d+m([✓✗])\x1b\[0m (\w+): ", re.MULTILINE)  # `Open.__call__`
PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>omnistereo: your progress</title>
<style>
:root {{ color-scheme: light dark; }}
h1 {{ font-size: 1.6em; }}
a {{ color: inherit; text-decoration-thickness: 1px; text-underline-offset: 0.2em; }}
body {{ font: 18px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 46em; padding: 0 1em; }}
progress {{ height: 1.5em; width: 100%; }}
h2 {{ font-size: 1.1em; margin: 1.2em 0 0; }}
li {{ display: inline-block; list-style: none; margin-right: 1.2em; }}
ul {{ margin: 0; padding: 0; }}
.right {{ color: light-dark(#1a7f37, #5fd068); }}
.wrong {{ color: light-dark(#b42318, #ff8f85); }}
figure {{ border: 3px double; margin: 2em 0; padding: 1em; text-align: center; }}
img {{ max-width: 100%; }}
</style>
<main>
<h1>{count} of {total} functions are right</h1>
<progress value="{count}" max="{total}" aria-label="functions that are right"></progress>
<p>{following}The links work as long as <code>make lab</code> runs.</p>
{method}
{rows}
{certificate}
</main>
</html>
"""
CERTIFICATE = """<figure>
<h2>omnistereo, the whole course</h2>
<p>All {total} functions are right, and this is what they compute: a depth panorama from four fisheye images.</p>
<img src="data:{mime};base64,{picture}" alt="{alt}">
</figure>"""


def write_progress(out: Path) -> None:
    """Write the page, and print the counts."""
    rows, count, total, following, lab = [], 0, 0, "", lab_address()
    for path in nbtools.notebooks():
        if not (functions := exercises.functions(nbtools.number(path))):
            continue
        copy = WORKING / path.name
        marks, address = read_marks(copy), f"{lab}/{WORKING.name}/{path.name}"
        names = [function.name for function in functions]
        found = [marks.get(name, "") for name in names]
        count, total = count + found.count("✓"), total + len(found)
        facts = nbtools.read_notebook(path).metadata["omnistereo"]
        title = f"{nbtools.number(path)} {facts['title']}"
        items = "".join(map(_item, names, found))
        link = f'<a href="{address}">{html.escape(title)}</a>'
        rows.append(f"<h2>{link}: {found.count('✓')} of {len(found)}</h2>\n<ul>{items}</ul>")
        if not following and found.count("✓") < len(found):
            name = next(name for name, mark in zip(names, found, strict=True) if mark != "✓")
            following = f"Go on with <code>{name}</code> in {link}. "
        print(f"{title}: {found.count('✓')} of {len(found)}")
    method = _own_method()
    certificate = _certificate(total) if count == total else ""
    out.parent.mkdir(parents=True, exist_ok=True)
    parts = {"following": following, "method": method, "certificate": certificate}
    parts |= {"rows": "\n".join(rows)}
    write_text(out, PAGE.format(count=count, total=total, **parts))
    right = f"{count} of {total} functions are right"
    print(f"{right}. Written: {out}. Save a notebook to have it counted.")


def _own_method() -> str:
    """Return and print the error and the time of the student's method beside the library's."""
    file = WORKING / "mine" / mine.WHOLE
    if not file.is_file():
        return ""
    judged = {
        f"yours, mine/{mine.WHOLE}": table.by_file(file),
        f"the library's {table.LIBRARY}": table.by_library,
    }
    rows = [table.judged(name, index_of, ("sunny",)) for name, index_of in judged.items()]
    said = [
        (
            f"{row.name}: {row.errors['>3']:.1f} % of the rays off by more than 3 %, mean error"
            f" {row.errors['MAE']:.2f} %, {row.cpu_s:.1f} s of processor time"
            if row.errors
            else f"{row.name}: {row.said}"
        )
        for row in rows
    ]
    print("\n".join(said))
    items = "".join(f"<li>{html.escape(line)}</li>" for line in said)
    return f"<h2>Depth from four images, 320 × 80 rays, 64 spheres</h2>\n<ul>{items}</ul>"


def lab_address() -> str:
    """Return where the JupyterLab of this clone shows files; where it will, if none is running."""
    running = (s["url"] for s in list_running_servers() if Path(s["root_dir"]) == nbtools.ROOT)
    return f"{next(running, 'http://localhost:8888/')}lab/tree"


def read_marks(path: Path) -> dict[str, str]:
    """Return ✓ or ✗ of the functions that a working copy has tried, by name."""
    if not path.exists():
        return {}
    cells = nbtools.code_cells(nbtools.read_notebook(path))
    outputs = [output for cell in cells for output in cell.outputs]
    return {name: mark for output in outputs for mark, name in SAID.findall(output.get("text", ""))}


def _item(name: str, mark: str) -> str:
    kind = {"✓": "right", "✗": "wrong"}.get(mark, "")
    return f'<li><span class="{kind}">{mark or "·"}</span> <code>{name}</code></li>'


def _certificate(total: int) -> str:
    path = next(path for path in nbtools.notebooks() if nbtools.number(path) == "06")
    cells = nbtools.code_cells(nbtools.read_notebook(WORKING / path.name))
    for output in itertools.chain(*(cell.outputs for cell in cells if PICTURE in cell.source)):
        for mime in set(nbtools.PICTURES) & set(output.get("data", {})):
            picture = html.escape(str(output.data[mime]).replace("\n", ""))
            alt = html.escape(str(output.data.get("text/plain", "")))
            return CERTIFICATE.format(total=total, mime=mime, picture=picture, alt=alt)
    return ""  # it was removed
