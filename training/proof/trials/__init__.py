"""What is concealed in a trial, and the recordings that are made of it."""
