"""One dataclass per subcommand; its `run` returns the exit code."""
