"""How wrong a z is: residuals of rows, what they are compared with, the certificate."""
