"""VolumeNet without torch: one ONNX file for a rig, and the script that runs it."""
