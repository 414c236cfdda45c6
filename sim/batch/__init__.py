"""Closed-loop simulation of many robots at once: what every change of skill is proven with."""
