"""Policies for other machines: ONNX, C for a microcontroller, NumPy; each with a contract and test vectors.

`network` is the float32 network that all formats hold, `contract` what numbers go in and out, `vectors` what
must come out; `onnx_file`, `c_source` and `numpy_file` write one format each, `command` all of it.
"""
