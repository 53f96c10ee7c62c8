"""From a folder or a video to pictures whose features are known."""
