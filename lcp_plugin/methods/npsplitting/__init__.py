"""The paper's Method 3.1 with any splitting, the left-hand matrix factorised once."""
