"""Where frames come from and go to: SocketCAN, other interfaces, log files, an in-process bus."""
