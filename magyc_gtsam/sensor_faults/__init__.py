"""What is wrong with the samples: axes that stand still, and readings cut off at full scale."""
