"""Why a trained run is not better: its log, its residuals per view and region, and the evidence in the pictures themselves."""
