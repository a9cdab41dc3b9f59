"""Policies for other machines: ONNX, or C for a microcontroller, with a contract and test vectors.

`contract` states the meaning of inputs and outputs and `vectors` the expected outputs; `onnx_file` and
`c_source` write one format each, and `command` writes an export.
"""
