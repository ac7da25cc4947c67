"""What benchmarks/diagnosis.py injects: its cases, policies that misbehave, a judge that cannot be relied on."""
