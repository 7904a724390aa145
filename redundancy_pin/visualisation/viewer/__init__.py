"""Moving pictures: a scene as arrays, and the page or live view that shows it."""
