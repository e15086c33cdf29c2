"""Programs that refit the coefficients of confidences and of filled cells."""
