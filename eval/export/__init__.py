"""Policies for other machines: ONNX, C for a microcontroller, NumPy; each with a contract and test vectors.

`network` is the float32 network that all formats contain, `contract` the meaning of inputs and outputs,
`vectors` the expected outputs; `onnx_file` and `c_source` write one format each, `command` all
of it.
"""
