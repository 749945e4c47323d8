"""Handles files of this computer: regular ones only, whole or not at all, inputs that no output may replace."""
