"""The workbench: a design that is edited, and figures of it that follow, the newest first.

One thread computes. It takes the newest state that there is, so that no queue forms: what a slider passed
over while a figure was made is never computed. When nothing changes any more, figures are made anew as the
commands make them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from lensdesign.errors import InputError, TransferLensError
from lensdesign.files.design import design_text
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.paths import FIELD_SHARES
from studio.model.built import ManufacturingQuality, manufacturing_quality
from studio.model.document import Autosave, Document, opened, tables_text
from studio.model.editing import Editing, Step, Tables, with_value
from studio.model.figures import FigureRequest, Figures, patch_of, rays_of, waves_of
from studio.model.values import parsed, path_of_key
from studio.model.whatif import WhatIf

SETTLE_SECONDS = 0.25
"""Without a change, after which figures are made as the commands make them."""

Listener = Callable[[], None]


class Workbench:
    """A design that is edited, and its figures.

    Parameters
    ----------
    design
        A design file, or a lens, which then belongs to no file.
    grade
        By which it is predicted as built: a grade, or a tolerance study's file.
    aside
        Where unsaved edits are kept; nowhere where left out.

    Raises
    ------
    InputError
        If the file holds no lens.
    """

    def __init__(
        self, design: Path | str | Lens, grade: str = "precision", autosave: Autosave | None = None
    ) -> None:
        if isinstance(design, Lens):
            path = Path("lens.toml")
            tables = _tables_of(design)
            self.document, self.editing = Document(path, ""), Editing(path, Step(tables, design, "given"))
        else:
            self.document, self.editing = opened(Path(design))
        self.opened: Tables = self.editing.now.tables
        self.saved: Tables = self.opened
        self.autosave = autosave
        if autosave is not None:
            self.editing = autosave.restored(self.document, self.editing)
        self.what_if = WhatIf()
        self.grade = grade
        self.patch_fraction = FIELD_SHARES[1]
        self.figures = Figures(self.lens)
        self.refused: dict[str, str] = {}
        self._quality: tuple[str, tuple[Any, ...], ManufacturingQuality | None] | None = None
        self._listeners: list[Listener] = []
        self._condition = threading.Condition()
        self._requested = 0
        self._ended = False
        self._thread: threading.Thread | None = None

    @property
    def lens(self) -> Lens:
        """The lens as it is."""
        return self.editing.lens

    @property
    def is_saved(self) -> bool:
        """Whether the file holds what is shown."""
        return self.editing.now.tables == self.saved

    # What changes the lens.

    def edit(self, key: str, kind: str, text: str, gesture: str = "") -> bool:
        """Change one value as it was typed; whether it was taken. If not, `refused` says why, by its key."""
        table_path = path_of_key(key)
        return self.change(
            key, lambda tables: with_value(tables, table_path, parsed(kind, text)), key, gesture
        )

    def change(
        self, description: str, of_tables: Callable[[Tables], Tables], key: str = "", gesture: str = ""
    ) -> bool:
        """Change the tables; whether it was taken."""
        try:
            editing = self.editing.changed(of_tables(self.editing.now.tables), description, gesture)
        except (InputError, TransferLensError) as error:
            prefix = f"{self.editing.path}: "
            self.refused = {key: "\n".join(line.removeprefix(prefix) for line in str(error).splitlines())}
            self.notify()
            return False
        self._replace(editing)
        return True

    def load(self, lens: Lens, description: str) -> bool:
        """Put another lens in place of this one; it can be undone."""
        return self.change(description, lambda _: _tables_of(lens))

    def undo(self) -> None:
        """One step back."""
        self._replace(self.editing.undone())

    def redo(self) -> None:
        """One step forward again."""
        self._replace(self.editing.redone())

    def save(self, path: Path | None = None) -> None:
        """Write the design's file, or another one, which is then the design's.

        Raises
        ------
        InputError
            As of :meth:`Document.saved`.
        """
        self.document = self.document.saved(self.editing, path)
        self.editing = replace(self.editing, path=self.document.path)
        self.saved = self.editing.now.tables
        self._keep()
        self.notify()

    def set_what_if(self, what_if: WhatIf) -> None:
        """Change how far the lens is off."""
        self.what_if = what_if
        self.request_update()

    def set_grade(self, grade: str) -> None:
        """Change by which tolerances the lens is predicted."""
        self.grade = grade
        self.request_update()

    def set_patch(self, share: float) -> None:
        """Change where on the object the patch is, as a share of the half field."""
        self.patch_fraction = share
        self.request_update()

    def _replace(self, editing: Editing) -> None:
        self.editing, self.refused = editing, {}
        self.request_update()

    # Who listens, and who computes.

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Have a function called, in any thread, after each change and each figure; gives what ends that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener) if listener in self._listeners else None

    def notify(self) -> None:
        """Call those who listen."""
        for listener in tuple(self._listeners):
            listener()

    def request_update(self) -> None:
        """Have figures made of the state as it is."""
        with self._condition:
            self._requested += 1
            if self._thread is None or not self._thread.is_alive():
                self._thread = threading.Thread(target=self._work, daemon=True, name="figures")
                self._thread.start()
            self._condition.notify_all()
        self.notify()

    def close(self) -> None:
        """End the thread."""
        with self._condition:
            self._ended = True
            self._condition.notify_all()

    def settle(self) -> Figures:
        """Figures as the commands make them, in this thread."""
        request = FigureRequest(self.lens, self.what_if, self._quality_for(self.lens), self.patch_fraction)
        for stage in (rays_of, waves_of, patch_of):
            self._publish(stage(request, settled=True))
        return self.figures

    def _work(self) -> None:
        done = 0
        while True:
            with self._condition:
                if not self._ended and self._requested == done:
                    self._condition.wait(60.0)
                if self._ended:
                    return
                if self._requested == done:
                    continue
                done = self._requested
            try:
                request = FigureRequest(self.lens, self.what_if, None, self.patch_fraction)
                self._keep()
                self._publish(rays_of(request, settled=False))
                request = replace(request, quality=self._quality_for(request.lens))
                for stage in (waves_of, patch_of):
                    self._publish(stage(request, settled=False))
                if self._is_idle(done):
                    for stage in (rays_of, waves_of, patch_of):
                        self._publish(stage(request, settled=True))
                        if self._requested != done:
                            break
            except TransferLensError as error:
                self._publish(Figures(self.lens, refused=(str(error),)))

    def _is_idle(self, done: int) -> bool:
        with self._condition:
            self._condition.wait_for(lambda: self._ended or self._requested != done, SETTLE_SECONDS)
            return not self._ended and self._requested == done

    def _quality_for(self, lens: Lens) -> ManufacturingQuality | None:
        """Of the grade; tolerances stay while values move, and follow what the lens is made of."""
        built_of = (len(lens.surfaces), lens.half_field_mm, tuple(s.material for s in lens.surfaces))
        if self._quality is None or self._quality[:2] != (self.grade, built_of):
            try:
                quality = manufacturing_quality(self.grade, lens) if self.grade else None
            except TransferLensError as error:
                quality = None
                self.refused = {"grade": str(error)}
            self._quality = (self.grade, built_of, quality)
        return self._quality[2]

    def _publish(self, result: Figures) -> None:
        """Put what a stage found in place of what was there."""
        new = {
            f.name: value
            for f in fields(result)
            if (value := getattr(result, f.name)) not in (None, ()) or f.name == "refused"
        }
        self.figures = replace(self.figures, **new)
        self.notify()

    def _keep(self) -> None:
        if self.autosave is not None:
            text = None if self.is_saved else tables_text(self.editing.now.tables)
            self.autosave.keep(tables=text, digest=self.document.digest)


def _tables_of(lens: Lens) -> Tables:
    """A lens as the tables of a design file."""
    import tomllib

    return tomllib.loads(design_text(lens))
