"""Widgets must load the Qt binding that the app will load."""

from __future__ import annotations

from app.main import prepare_environment

prepare_environment()
