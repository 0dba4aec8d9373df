"""What is shown of a controller, recorded of it, and played back."""
