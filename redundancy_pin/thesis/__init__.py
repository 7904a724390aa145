"""Studies on shipped robots: the reproduction of the thesis; one kind of case, one memo of plans, one table."""
