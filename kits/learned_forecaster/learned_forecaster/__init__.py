"""A forecaster that is learned from evidence: sessions in numbers, a logistic model of them, and its file."""
