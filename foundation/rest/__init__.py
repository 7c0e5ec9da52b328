"""What every REST API of ours has: who may ask, how much, refusals as problem documents, and the server."""
