"""What comes next, and when to stop."""
