"""Freedrive: a person moves the arm by hand while its program runs."""

from koala3d.capture.drivers.errors import MotionError
from koala3d.capture.drivers.events import event
from koala3d.capture.drivers.ur.link import ChildLink, Deadlines


class HandGuided:
    """The part of an arm of Universal Robots that lets go of it; see `UniversalRobot`."""

    host: str
    deadlines: Deadlines

    def _connected(self) -> ChildLink:
        raise NotImplementedError

    def freedrive(self, on: bool) -> None:
        """Let a person move the arm by hand, or hold it where it is. Nothing else may move it meanwhile; `stop` ends it.

        Raises MotionError: the controller did not do it.
        """
        link = self._connected()
        number = link.request("freedrive", on=on)
        answer = link.wait_for(("freed", "refused"), self.deadlines.accept_s, number=number) if number else None
        if answer is None or "refused" in answer:
            remedy = "look at the pendant; stop the arm before anybody touches it"
            raise MotionError(f"the controller did not switch freedrive {'on' if on else 'off'}", where=self.host, remedy=remedy)
        event("freedrive", on=on)
