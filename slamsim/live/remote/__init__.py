"""Robots that run elsewhere: what they send is mapped, checked and recorded here."""
