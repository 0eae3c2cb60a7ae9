"""What is computed offline about loops and drives: figures of merit, populations, designs, the paper, replays."""
