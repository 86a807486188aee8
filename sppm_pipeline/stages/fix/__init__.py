"""Stages that change a part so that it can be printed."""
