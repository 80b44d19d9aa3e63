"""A plan as files and pages: plan.json, plan.png, plan.html, and the picture in a notebook."""

from __future__ import annotations

import base64
import tempfile
from pathlib import Path

from ..files import file_stem, make_folder, write_json, write_text, write_whole
from ..hiis.analyser import VirtualGrasp
from ..objects.load import IN_MEMORY
from ..report.plain import html_text as escape
from .answers import PlanRecord, answers_of
from .document import Document, plan_to_json


def save_plan(plan: PlanRecord, folder: Path, document: Document | None = None) -> list[Path]:
    """Write plan.json, plan.png and plan.html, each whole or not at all.

    Args:
        plan: The plan.
        folder: Folder of the files; it is created if it is missing.
        document: The plan's JSON, if the caller already has it. If the object's surface is written to the
            folder too, the object's source is changed in this document.

    Returns:
        The files that were written.

    Raises:
        EnvironmentFailure: A file cannot be written.
    """
    from ..physics.task.instances import mesh_text
    from ..pictures import document_html, plan_picture_of

    make_folder(folder)
    document = document or plan_to_json(plan)
    files = [folder / "plan.json", folder / "plan.png", folder / "plan.html"]
    if plan.mesh.scan is not None or plan.source.endswith(IN_MEMORY):
        surface = folder / f"{file_stem(plan.mesh.name)}-surface.obj"
        write_text(surface, mesh_text(plan.mesh))
        files.append(surface)
        # The surface that planning used is beside the plan, in metres; other commands find it there.
        for one in (document, *document["alternatives"], *([document["best"]] if document["best"] else [])):
            one["object"]["source"] = surface.name
    write_json(files[0], document)
    write_whole(
        files[1], lambda path: plan_picture_of(document, plan.mesh, plan.hand, path, ray_origins(plan))
    )
    write_text(files[2], document_html(plan.mesh, plan.hand, document, ray_origins(plan)))
    return files


def show_plan(plan: PlanRecord) -> Path:
    """Write the plan's page to a temporary folder and open it in the web browser.

    Raises:
        EnvironmentFailure: The page cannot be written.
    """
    import webbrowser

    from ..pictures import document_html

    page = Path(tempfile.mkdtemp(prefix="preshape-")) / "plan.html"
    write_text(page, document_html(plan.mesh, plan.hand, plan_to_json(plan), ray_origins(plan)))
    webbrowser.open(page.as_uri())
    return page


def notebook_html(plan: PlanRecord) -> str:
    """The picture with the figures below it, for a notebook."""
    from ..pictures import plan_picture_of

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "plan.png"
        plan_picture_of(plan_to_json(plan), plan.mesh, plan.hand, file, ray_origins(plan))
        picture = base64.b64encode(file.read_bytes()).decode("ascii")
    return (
        f'<img alt="{escape(repr(plan))}" style="max-width:100%" src="data:image/png;base64,{picture}">'
        f"<pre>{escape(str(plan))}</pre>"
    )


def ray_origins(plan: PlanRecord) -> list[list[list[float]]]:
    """Start points of the rays of each answer that was found by ray casting, mesh frame [m]."""
    return [a.grasp.ray_origins.tolist() for a in answers_of(plan) if isinstance(a.grasp, VirtualGrasp)]
