"""What of a recording to believe: poses, clocks, channels and mounting, checked and told as a health report."""
