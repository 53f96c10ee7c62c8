"""What the pictures say of a scene before anything is trained: the measurements that decisions rest on, one a file."""
