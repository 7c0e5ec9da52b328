"""The controller in structured text, as a service: compiled, and run in the controller's own shell."""
