"""Sources and sinks of frames: SocketCAN, other interfaces, log files, a bus inside the process."""
