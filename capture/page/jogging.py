"""Controls of the live page that move the arm to views of the trajectory."""

from collections.abc import Callable

import viser

from koala3d.capture.sessions.live.jog import Jog

Later = Callable[[Callable[[], None]], None]
"""Leaves a task to the thread that owns camera and arm."""


class JogPanel:
    """A choice of views, and buttons that go there, stop, and allow motions again."""

    def __init__(self, gui: viser.GuiApi, jog: Jog, later: Later) -> None:
        self.jog = jog
        with gui.add_folder("Arm"):
            self.view = gui.add_dropdown("view", tuple(jog.views))
            gui.add_button("go there", hint="the picture rests while the arm moves").on_click(lambda event: later(self._go))
            gui.add_button("stop the arm", color="red").on_click(lambda event: jog.robot.stop())
            again = gui.add_button("allow motions again", hint="after a stop nothing moves until then")
            again.on_click(lambda event: later(jog.robot.clear_stop))
            self.where = gui.add_markdown("*the arm rests where it was found*")

    def _go(self) -> None:
        name = self.view.value
        self.where.content = f"*on the way to {name}*"
        try:
            self.jog.go(name)
        except BaseException:
            self.where.content = f"*did not arrive at {name}*"
            raise
        self.where.content = f"at **{name}**"
