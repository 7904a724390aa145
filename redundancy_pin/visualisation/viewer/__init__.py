"""Moving pictures: a scene in plain arrays, and the page or live view that shows it."""
