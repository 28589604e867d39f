"""The table of jobs of 0.1.0."""

import sqlalchemy as sql
from alembic import op

revision, down_revision = "1", None
SAFE = True


def upgrade() -> None:
    """Make the table."""
    op.create_table(
        "deitalk_jobs",
        sql.Column("id", sql.String(64), primary_key=True),
        sql.Column("owner", sql.String(64), nullable=False, index=True),
        sql.Column("status", sql.String(16), nullable=False, index=True),
        sql.Column("work", sql.Text, nullable=False),
        sql.Column("created", sql.Float, nullable=False, index=True),
        sql.Column("started", sql.Float),
        sql.Column("finished", sql.Float),
        sql.Column("progress", sql.Float, nullable=False),
        sql.Column("attempts", sql.Integer, nullable=False),
        sql.Column("holder", sql.String(64), nullable=False),
        sql.Column("lease", sql.Float, nullable=False),
        sql.Column("cancel", sql.Integer, nullable=False),
        sql.Column("ends", sql.Integer, nullable=False),
        sql.Column("result", sql.String(200)),
        sql.Column("result_bytes", sql.Integer, nullable=False),
        sql.Column("answer", sql.Text),
        sql.Column("error", sql.Text),
        sql.Column("idempotency", sql.String(300), unique=True),
        sql.Column("digest", sql.String(64), nullable=False),
        sql.Column("webhook", sql.String(500)),
        sql.Column("webhook_left", sql.Integer, nullable=False),
        sql.Column("webhook_at", sql.Float, nullable=False),
    )
