"""Find faulty samples: stuck axes, readings cut off at full scale, repeats and placeholders."""
