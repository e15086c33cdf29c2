"""What the buttons are called, and which place holds one."""
