"""What trained runs look like from anywhere: along a camera's path, and under the hands of whoever looks."""
