"""Controls of the live page that move the arm to views of the trajectory or by steps, and take its pose as a view."""

from collections.abc import Callable

import numpy as np
import viser

from koala3d.capture.sessions.live.jog import Jog
from koala3d.capture.sessions.live.teach import Teaching
from koala3d.datasets.core.errors import KoalaError

Later = Callable[[Callable[[], None]], None]
"""Leaves a task to the thread that owns camera and arm."""
AXES = {"right": (0, 1), "left": (0, -1), "down": (1, 1), "up": (1, -1), "forward": (2, 1), "back": (2, -1)}
"""Name of a step: axis of the camera, and sign."""
TURNS = {
    "look down": (0, -1),
    "look up": (0, 1),
    "look right": (1, 1),
    "look left": (1, -1),
    "roll right": (2, 1),
    "roll left": (2, -1),
}
"""The same of turns: x points right and y down, so that the picture's middle moves as the name says."""


class JogPanel:
    """A choice of views, buttons that go there or a step further, stop, and allow motions again; with `teaching` one more."""

    def __init__(self, gui: viser.GuiApi, jog: Jog, later: Later, teaching: Teaching | None = None) -> None:
        self.jog, self.teaching, self._later = jog, teaching, later
        with gui.add_folder("Arm"):
            self.view = gui.add_dropdown("view", tuple(jog.views))
            gui.add_button("go there", hint="the picture rests while the arm moves").on_click(lambda event: later(self._go))
            gui.add_button("stop the arm", color="red").on_click(lambda event: jog.stop())
            again = gui.add_button("allow motions again", hint="after a stop nothing moves until then")
            again.on_click(lambda event: later(jog.robot.clear_stop))
            self.where = gui.add_markdown("*the arm rests where it was found*")
            if jog.obstacles.carrier.beside is None:
                self._add_steps(gui)
            if jog.can_be_freed:
                self.free = gui.add_checkbox("freedrive", False, hint="hold the arm before you switch it on")
                self.free.on_update(lambda event: self._when_changed())
            if teaching is not None:
                gui.add_button("take this pose as a view", color="green").on_click(lambda event: later(self._take))
                self.taken = gui.add_markdown(f"*views go to {teaching.path}*")

    def _add_steps(self, gui: viser.GuiApi) -> None:
        """Buttons along and about the camera's axes."""
        with gui.add_folder("Steps in the camera's axes"):
            self.length = gui.add_number("step [mm]", 10.0, min=0.1, max=100.0, step=0.1)
            moves = gui.add_button_group("move", tuple(AXES))
            moves.on_click(lambda event: self._step(AXES[moves.value], turn=False))
            self.angle = gui.add_number("step [degrees]", 2.0, min=0.1, max=20.0, step=0.1)
            turns = gui.add_button_group("turn", tuple(TURNS))
            turns.on_click(lambda event: self._step(TURNS[turns.value], turn=True))

    def _step(self, towards: tuple[int, int], *, turn: bool) -> None:
        axis, sign = towards
        size = np.radians(self.angle.value) if turn else 1e-3 * self.length.value
        vector = sign * size * np.eye(3)[axis]
        self._later(lambda: self._stepped(np.zeros(3) if turn else vector, vector if turn else np.zeros(3)))

    def _stepped(self, shift: np.ndarray, turn: np.ndarray) -> None:
        self.where.content = "*on the way*"
        try:
            self.jog.step(shift, turn)
        finally:
            self._show_freedrive()
            self.where.content = "between views"

    def _when_changed(self) -> None:
        """Freedrive as the box says. The box may also have been changed by the program, which then agrees with the arm."""
        wanted = self.free.value
        if wanted != self.jog.is_free:
            self._later(lambda: self._set_free(wanted))

    def _set_free(self, on: bool) -> None:
        try:
            self.jog.free(on)
            self.where.content = "**free: move it by hand**" if on else "held, between views"
        finally:
            self._show_freedrive()

    def _show_freedrive(self) -> None:
        if self.jog.can_be_freed and self.free.value != self.jog.is_free:
            self.free.value = self.jog.is_free

    def _take(self) -> None:
        assert self.teaching is not None  # its button is there
        try:
            name = self.teaching.take(self.jog.robot.state().joints)
        except KoalaError as error:
            self.taken.content = f"*not taken: {error}*"
            return
        self.taken.content = f"view **{name}** taken; {self.teaching.path}"

    def _go(self) -> None:
        name = self.view.value
        self.where.content = f"*on the way to {name}*"
        try:
            self.jog.go(name)
        except BaseException:
            self.where.content = f"*did not arrive at {name}*"
            raise
        finally:
            self._show_freedrive()
        self.where.content = f"at **{name}**"
