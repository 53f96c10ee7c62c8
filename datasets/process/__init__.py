"""From photographs or a video to a scene: pictures, features, matches, poses, scale and up, one after the other."""
