"""A phone as an input device: a separate small HTTPS server that the user starts (extra ``phone``)."""

from carina.phone.switch import PhoneSwitch

__all__ = ["PhoneSwitch"]
