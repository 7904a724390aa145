"""Forward dynamics of closed chains."""
