"""A phone as an input device: a small HTTPS server of its own, off until a person opens it (extra ``phone``)."""

from carina.phone.switch import PhoneSwitch

__all__ = ["PhoneSwitch"]
