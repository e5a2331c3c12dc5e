"""The model of a recording, linear in small changes of the object and of the bench."""
