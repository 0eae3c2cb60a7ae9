"""What every room stands on: compiled code, validated quantities, signals, messages, text that is read and written."""
