"""What a scene does not need: found out once, decided with evidence, logged with saving and cost."""
