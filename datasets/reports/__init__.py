"""HTML reports: the page shared by all reports, drawings, and the report of a scene."""
