"""*Step through*: the kept steps of a slot in its column, under the slider there and in a tab with their curves."""

from __future__ import annotations

from functools import partial

from PyQt6.QtCore import QObject

from app.frame.instrument import Instrument
from app.session.layout import Layout
from app.work.drawing import SlotShown
from pipeline.base.params import changed, settings
from pipeline.engine.graph import Method

_KEEPS = "keep_"  # how the parameters begin that keep steps
_USUAL = "pose"
_CANNOT = "{} keeps no steps; choose another method for it"
_ON_ITS_WAY, _NONE_HERE = "steps are kept from the next answer on", "this answer took no steps"


class Stepping(QObject):
    """Between the tab, the sliders under the 3D views and the session; steps are kept only where somebody asks."""

    def __init__(self, instrument: Instrument) -> None:
        super().__init__(instrument)
        self._instrument, self._panel = instrument, instrument.window.step_tab
        window, panel = instrument.window, self._panel
        panel.slot_chosen.connect(self._show)
        panel.keep_wanted.connect(self.keep)
        panel.step_chosen.connect(self._choose)
        for slot, slider in window.steps.items():
            slider.keep_wanted.connect(self.ask)
            slider.slider.valueChanged.connect(partial(self._at, slot))
        instrument.frame_shown.connect(self._show)
        instrument.session_shown.connect(self._show)
        window.on("step_through", lambda: self.ask(self._panel.slot or _USUAL))

    def ask(self, slot: str) -> None:
        """Bring the tab to the front, and keep the steps of a slot from now on."""
        window, layout = self._instrument.window, self._instrument.session.layout
        window.drawers.reading.show()
        window.drawers.reading.raise_()
        window.tabs.setCurrentWidget(self._panel)
        self._panel.choose(slot)
        if slot in window.here and slot not in window.visible_columns():
            self._instrument.change("show stages", layout=Layout(panes=layout.panes))
        self.keep(slot, keep=True)
        self._show()

    def keep(self, slot: str, keep: bool) -> None:
        """Whether the steps of a slot are kept."""
        method = self._method(slot)
        if method is not None and (name := _keeps(method)):
            session = self._instrument.session
            params = {**session.params, method.key: changed(session.params_of(method), name, keep)}
            self._instrument.change("keep steps" if keep else "keep no steps", params=params)

    def _method(self, slot: str) -> Method | None:
        opened = self._instrument.screen.opened
        return None if opened is None else next((m for m in opened.methods if m.slot == slot), None)

    def _show(self, *_: object) -> None:
        instrument, window, panel = self._instrument, self._instrument.window, self._panel
        titles = {slot: instrument.catalogue.slot(slot).title for slot in window.here if slot in window.steps}
        panel.offer_slots(titles)
        for slot, slider in window.steps.items():
            slider.offer(keeps=(method := self._method(slot)) is not None and bool(_keeps(method)))
        method, part = self._method(panel.slot), instrument.screen.shown(panel.slot)
        name = "" if method is None else _keeps(method)
        kept = bool(name) and method is not None and bool(settings(instrument.session.params_of(method))[name][0])
        way = part.way if isinstance(part, SlotShown) else None
        why_not = _CANNOT.format(titles.get(panel.slot, "this slot")) if method is not None and not name else ""
        if kept and way is None:
            why_not = _NONE_HERE if instrument.idle else _ON_ITS_WAY
        panel.show_way(way, kept=kept, can=bool(name), why_not=why_not)
        if way is not None:
            panel.show_at(window.steps[panel.slot].slider.value())

    def _choose(self, slot: str, at: int) -> None:
        self._instrument.window.steps[slot].slider.setValue(at)

    def _at(self, slot: str, at: int) -> None:
        if slot == self._panel.slot:
            self._panel.show_at(at)


def _keeps(method: Method) -> str:
    """The parameter that makes a method keep its steps, "" for none."""
    return next((name for name in settings(method.params()) if name.startswith(_KEEPS)), "")
