"""From sound to skill requests: sources, matcher, tracker, conductor."""
