"""Workbench: a design that is edited, and its analysis, which is updated after each change.

One thread analyses the newest state. Intermediate states, such as those of a moving slider,
are skipped, so that no queue builds up. When the design stops changing, the analysis is repeated with
the accuracy of the commands.
"""

from __future__ import annotations

import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from lensdesign.errors import InputError, TransferLensError
from lensdesign.files.design import design_text
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.paths import FIELD_FRACTIONS
from studio.model.analysis import RESULTS, STAGES, AnalysisRequest, LensAnalysis
from studio.model.built import ManufacturingQuality, manufacturing_quality
from studio.model.document import Autosave, Document, opened, tables_text
from studio.model.editing import Editing, Step, Tables, with_value
from studio.model.session import Session
from studio.model.values import parsed, path_of_key
from studio.model.whatif import WhatIf

Listener = Callable[[], None]


class _Superseded(Exception):
    """The design has changed since the start of an analysis."""


class Workbench:
    """A design that is edited, and its analysis.

    Parameters
    ----------
    design
        A design file, or a lens without a file.
    grade
        Tolerances for the prediction as built: a grade (default: precision), or a tolerance study's file.
    autosave
        Store of unsaved edits (default: none).

    Raises
    ------
    InputError
        If the file does not describe a lens.

    Examples
    --------
    >>> from studio import Workbench
    >>> bench = Workbench("design.toml")  # doctest: +SKIP
    >>> bench.edit("surface.0.radius_mm", "number", "42.5")  # doctest: +SKIP
    True
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
        self._kept: tuple[Document, Tables | None] | None = None
        if autosave is not None:
            self.editing = autosave.restored(self.document, self.editing)
        self.what_if = WhatIf()
        self.session = Session.of_lens(self.lens)
        self.opened_designs = 0
        self.grade = grade
        self.patch_fraction = FIELD_FRACTIONS[1]
        self.analysis = LensAnalysis(self.lens)
        self.refused: dict[str, str] = {}
        self._quality: tuple[str, tuple[Any, ...], ManufacturingQuality | None, str] | None = None
        self._listeners: list[Listener] = []
        self._condition = threading.Condition()
        self._requested = 0
        self._analysed = 0
        self._settled = 0
        self._ended = False
        self._thread: threading.Thread | None = None

    @property
    def lens(self) -> Lens:
        """Present lens."""
        return self.editing.lens

    @property
    def is_analysed(self) -> bool:
        """True if the analysis, with the accuracy of a moving value at least, is of the present state."""
        return self._analysed == self._requested

    @property
    def is_saved(self) -> bool:
        """True if the file holds the present design."""
        return self.editing.now.tables == self.saved

    # Changes of the lens.

    def edit(self, key: str, kind: str, text: str, gesture: str = "") -> bool:
        """Set one value from text; return whether it was accepted. If not, `refused` holds the reason."""
        table_path = path_of_key(key)
        return self.change(
            key, lambda tables: with_value(tables, table_path, parsed(kind, text)), key, gesture
        )

    def change(
        self, description: str, of_tables: Callable[[Tables], Tables], key: str = "", gesture: str = ""
    ) -> bool:
        """Change the tables; return whether the change was accepted."""
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
        """Replace the lens; the change can be undone."""
        return self.change(description, lambda _: _tables_of(lens))

    def undo(self) -> None:
        """Undo one step."""
        self._replace(self.editing.undone())

    def redo(self) -> None:
        """Redo one step."""
        self._replace(self.editing.redone())

    def save(self, path: Path | None = None) -> None:
        """Write the design file, or another file, which then becomes the design file.

        Raises
        ------
        InputError
            If the file changed on disk, another file exists, or the file cannot be written.
        """
        self.document = self.document.saved(self.editing, path)
        self.editing = replace(self.editing, path=self.document.path)
        self.saved = self.editing.now.tables
        self._keep()
        self.notify()

    def open(self, path: Path) -> None:
        """Open another design in place of this one. Unsaved edits of this one stay in the store.

        Raises
        ------
        InputError
            If the file cannot be read or does not describe a lens.
        """
        document, editing = opened(path)
        self._keep()
        if self.autosave is not None:
            self.autosave = Autosave(path, self.autosave.folder)
        self.session.close()
        self.document, self.editing, self.refused = document, editing, {}
        self.opened = self.saved = editing.now.tables
        if self.autosave is not None:
            self.editing = self.autosave.restored(document, editing)
        self.what_if, self.session = WhatIf(), Session.of_lens(self.lens)
        self.analysis = LensAnalysis(self.lens)
        self.opened_designs += 1
        self.request_update()

    def set_what_if(self, what_if: WhatIf) -> None:
        """Set the deviations of the lens from its design."""
        self.what_if = what_if
        self.request_update()

    def set_grade(self, grade: str) -> None:
        """Set the tolerances of the prediction."""
        self.grade = grade
        self.request_update()

    def set_patch(self, fraction: float) -> None:
        """Set the field height of the patch as a fraction of the half field."""
        self.patch_fraction = fraction
        self.request_update()

    def _replace(self, editing: Editing) -> None:
        self.editing, self.refused = editing, {}
        self.request_update()

    # Listeners and computation.

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Register a function that is called, in any thread, after each change; return its deregistration."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener) if listener in self._listeners else None

    def notify(self) -> None:
        """Call all listeners."""
        for listener in tuple(self._listeners):
            listener()

    def request_update(self) -> None:
        """Store unsaved edits, and request an analysis of the present state."""
        self._keep()
        with self._condition:
            self._requested += 1
            if self._thread is None or not self._thread.is_alive():
                self._thread = threading.Thread(target=self._work, daemon=True, name="analysis")
                self._thread.start()
            self._condition.notify_all()
        self.notify()

    def close(self) -> None:
        """Stop the computing thread and all jobs."""
        self.session.close()
        with self._condition:
            self._ended = True
            self._condition.notify_all()

    def settle(self) -> LensAnalysis:
        """Analyse the present state with full accuracy in this thread."""
        with self._condition:
            self._settled = self._requested
        request = self._with_quality(AnalysisRequest(self.lens, self.what_if, None, self.patch_fraction))
        for stage, names in STAGES:
            self._publish(stage(request, settled=True), names)
        self._analysed = self._requested
        self.notify()
        return self.analysis

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
                self._analyse(done)
            except _Superseded:
                continue
            except Exception as error:
                # Without this, the page would go on to show the figures of an earlier lens.
                traceback.print_exc(file=sys.stderr)
                why = f"the analysis failed: {type(error).__name__}: {error}"
                self._publish(LensAnalysis(self.lens, reasons=dict.fromkeys(RESULTS, why)), RESULTS, done)

    def _analyse(self, number: int) -> None:
        """Analyse the state of a request; if no other follows, with full accuracy at the end."""
        (rays, ray_names), *others = STAGES
        request = AnalysisRequest(self.lens, self.what_if, None, self.patch_fraction)
        self._publish(rays(request, settled=False), ray_names, number)
        request = replace(self._with_quality(request), proceed=partial(self._check_current, number))
        for stage, names in others:
            self._publish(stage(request, settled=False), names, number)
        self._analysed = max(self._analysed, number)
        self.notify()
        if self._is_idle(number):
            for stage, names in STAGES:
                self._publish(stage(request, settled=True), names, number)
                self._check_current(number)

    def _check_current(self, number: int) -> None:
        """End the analysis of a state that has changed since."""
        if self._ended or self._requested != number:
            raise _Superseded

    def _is_idle(self, done: int) -> bool:
        with self._condition:
            # Time without a change after which the analysis has full accuracy.
            settle_seconds = 0.25
            self._condition.wait_for(lambda: self._ended or self._requested != done, settle_seconds)
            return not self._ended and self._requested == done

    def _with_quality(self, request: AnalysisRequest) -> AnalysisRequest:
        """Return a request with the tolerances, which change only with surfaces, materials and field."""
        lens = request.lens
        built_of = (len(lens.surfaces), lens.half_field_mm, tuple(s.material for s in lens.surfaces))
        if self._quality is None or self._quality[:2] != (self.grade, built_of):
            quality, why = None, ""
            try:
                quality = manufacturing_quality(self.grade, lens) if self.grade else None
            except TransferLensError as error:
                why = str(error)
            self._quality = (self.grade, built_of, quality, why)
        return replace(request, quality=self._quality[2], no_quality=self._quality[3])

    def _publish(self, result: LensAnalysis, names: tuple[str, ...], number: int | None = None) -> None:
        """Update the analysis with the results of a stage, unless they are of a request before `settle`."""
        with self._condition:
            if number is not None and number <= self._settled:
                return
            self.analysis = self.analysis.updated(result, names)
        self.notify()

    def _keep(self) -> None:
        """Store the edits, or that there are none, if this is not what was stored last."""
        tables = None if self.is_saved else self.editing.now.tables
        content = self.document, tables
        if self.autosave is None or self._kept == content:
            return
        self._kept = content
        text = None if tables is None else tables_text(tables)
        self.autosave.keep(tables=text, digest=self.document.digest)


def _tables_of(lens: Lens) -> Tables:
    """Return a lens as the tables of a design file."""
    import tomllib

    return tomllib.loads(design_text(lens))
