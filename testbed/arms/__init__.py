"""Arms of one's own: whether drawing and machine agree, and a directory to begin with."""
