"""Commands that find, edit and measure the airways."""
