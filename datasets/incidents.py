"""What a session did by itself about faults, as the manifest of its recording keeps it, and what a person ignored."""

from koala3d.datasets.recording import Recording

INCIDENTS, LEFT_OUT = "incidents", "left out"
"""Part of the manifest that lists what was done, and what a view is called that was not taken."""
IGNORED = "ignored_checks"
"""Part of the manifest: what 'capture doctor' found to be wrong and a person ignored, by the names of its lines."""


def left_out(recording: Recording) -> list[str]:
    """Names of the views that a session gave up because the arm did not come to rest, and that no later run has taken."""
    entries = recording.manifest.get(INCIDENTS)
    there = {frame.name for frame in recording.frames}
    given_up = [one.get("view") for one in entries if one.get("what") == LEFT_OUT] if isinstance(entries, list) else []
    return sorted({str(name) for name in given_up} - there)
