"""What is installed: the lock, its bill of materials, its known vulnerabilities."""
