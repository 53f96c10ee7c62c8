"""Run time against error: frozen scenes, trainings under time budgets, what a step costs, and what the machine allows."""
