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
from studio.model.built import ManufacturingQuality, workmanship
from studio.model.document import Autosave, Document, opened, tables_text
from studio.model.editing import Editing, Step, Tables, with_value
from studio.model.figures import FigureRequest, Figures, patch_of, rays_of, waves_of
from studio.model.values import parsed, place_of
from studio.model.whatif import WhatIf

REST_SECONDS = 0.25
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
        self, design: Path | str | Lens, grade: str = "precision", aside: Autosave | None = None
    ) -> None:
        if isinstance(design, Lens):
            path = Path("lens.toml")
            tables = _tables_of(design)
            self.document, self.editing = Document(path, ""), Editing(path, Step(tables, design, "given"))
        else:
            self.document, self.editing = opened(Path(design))
        self.opened: Tables = self.editing.now.tables
        self.saved: Tables = self.opened
        self.aside = aside
        if aside is not None:
            self.editing = aside.restored(self.document, self.editing)
        self.what_if = WhatIf()
        self.grade = grade
        self.patch_share = FIELD_SHARES[1]
        self.figures = Figures(self.lens)
        self.refused: dict[str, str] = {}
        self._made: tuple[str, tuple[Any, ...], ManufacturingQuality | None] | None = None
        self._listeners: list[Listener] = []
        self._condition = threading.Condition()
        self._asked = 0
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
        place = place_of(key)
        return self.change(key, lambda tables: with_value(tables, place, parsed(kind, text)), key, gesture)

    def change(
        self, what: str, of_tables: Callable[[Tables], Tables], key: str = "", gesture: str = ""
    ) -> bool:
        """Change the tables; whether it was taken."""
        try:
            editing = self.editing.changed(of_tables(self.editing.now.tables), what, gesture)
        except (InputError, TransferLensError) as error:
            prefix = f"{self.editing.path}: "
            self.refused = {key: "\n".join(line.removeprefix(prefix) for line in str(error).splitlines())}
            self.tell()
            return False
        self._take(editing)
        return True

    def load(self, lens: Lens, what: str) -> bool:
        """Put another lens in place of this one; it can be undone."""
        return self.change(what, lambda _: _tables_of(lens))

    def undo(self) -> None:
        """One step back."""
        self._take(self.editing.undone())

    def redo(self) -> None:
        """One step forward again."""
        self._take(self.editing.redone())

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
        self.tell()

    def set_what_if(self, what_if: WhatIf) -> None:
        """Change how far the lens is off."""
        self.what_if = what_if
        self.ask()

    def set_grade(self, grade: str) -> None:
        """Change by which tolerances the lens is predicted."""
        self.grade = grade
        self.ask()

    def set_patch(self, share: float) -> None:
        """Change where on the object the patch is, as a share of the half field."""
        self.patch_share = share
        self.ask()

    def _take(self, editing: Editing) -> None:
        self.editing, self.refused = editing, {}
        self.ask()

    # Who listens, and who computes.

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Have a function called, in any thread, after each change and each figure; gives what ends that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener) if listener in self._listeners else None

    def tell(self) -> None:
        """Call those who listen."""
        for listener in tuple(self._listeners):
            listener()

    def ask(self) -> None:
        """Have figures made of the state as it is."""
        with self._condition:
            self._asked += 1
            if self._thread is None or not self._thread.is_alive():
                self._thread = threading.Thread(target=self._work, daemon=True, name="figures")
                self._thread.start()
            self._condition.notify_all()
        self.tell()

    def close(self) -> None:
        """End the thread."""
        with self._condition:
            self._ended = True
            self._condition.notify_all()

    def settle(self) -> Figures:
        """Figures as the commands make them, in this thread."""
        asked = FigureRequest(self.lens, self.what_if, self._workmanship(self.lens), self.patch_share)
        for stage in (rays_of, waves_of, patch_of):
            self._publish(stage(asked, settled=True))
        return self.figures

    def _work(self) -> None:
        done = 0
        while True:
            with self._condition:
                if not self._ended and self._asked == done:
                    self._condition.wait(60.0)
                if self._ended:
                    return
                if self._asked == done:
                    continue
                done = self._asked
            try:
                asked = FigureRequest(self.lens, self.what_if, None, self.patch_share)
                self._keep()
                self._publish(rays_of(asked, settled=False))
                asked = replace(asked, made=self._workmanship(asked.lens))
                for stage in (waves_of, patch_of):
                    self._publish(stage(asked, settled=False))
                if self._rests(done):
                    for stage in (rays_of, waves_of, patch_of):
                        self._publish(stage(asked, settled=True))
                        if self._asked != done:
                            break
            except TransferLensError as error:
                self._publish(Figures(self.lens, refused=(str(error),)))

    def _rests(self, done: int) -> bool:
        with self._condition:
            self._condition.wait_for(lambda: self._ended or self._asked != done, REST_SECONDS)
            return not self._ended and self._asked == done

    def _workmanship(self, lens: Lens) -> ManufacturingQuality | None:
        """Of the grade; tolerances stay while values move, and follow what the lens is made of."""
        built_of = (len(lens.surfaces), lens.half_field_mm, tuple(s.material for s in lens.surfaces))
        if self._made is None or self._made[:2] != (self.grade, built_of):
            try:
                made = workmanship(self.grade, lens) if self.grade else None
            except TransferLensError as error:
                made = None
                self.refused = {"grade": str(error)}
            self._made = (self.grade, built_of, made)
        return self._made[2]

    def _publish(self, found: Figures) -> None:
        """Put what a stage found in place of what was there."""
        new = {
            f.name: value
            for f in fields(found)
            if (value := getattr(found, f.name)) not in (None, ()) or f.name == "refused"
        }
        self.figures = replace(self.figures, **new)
        self.tell()

    def _keep(self) -> None:
        if self.aside is not None:
            text = None if self.is_saved else tables_text(self.editing.now.tables)
            self.aside.keep(tables=text, digest=self.document.digest)


def _tables_of(lens: Lens) -> Tables:
    """A lens as the tables of a design file."""
    import tomllib

    return tomllib.loads(design_text(lens))
