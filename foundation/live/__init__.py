"""What a service records, shown while it happens: to viewers over a WebSocket, to Prometheus as text."""
