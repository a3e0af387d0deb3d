"""A problem a time step, each of which teaches the next: march, march_many, their derivatives."""
