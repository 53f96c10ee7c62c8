"""What the commands of a control program do, one file for each family; `table` has them all by number."""
