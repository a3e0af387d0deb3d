"""Evidence: named scenes, pictures, tables and benchmarks. Heavy; nothing below looks at it."""
