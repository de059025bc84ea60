"""Access control: tokens, roles, sessions."""
