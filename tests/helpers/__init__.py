"""What several tests need: machines and recordings made without the package, servers, a browser, the command."""
