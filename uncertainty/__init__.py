"""What the mean-value plant leaves out, as robust-control deltas with guaranteed weights."""
