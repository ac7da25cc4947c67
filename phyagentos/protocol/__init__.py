"""The boundary: values and documents that both planes share. Imports no plane and no simulator."""
