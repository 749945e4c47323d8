"""Changes scenes from frame to frame: keyframes, animated scenes, turntables."""
