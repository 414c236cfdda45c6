"""What people type: the command line, demo, report, spy, bench."""
