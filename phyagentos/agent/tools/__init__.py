"""What an agent outside of this process may use: tools by level, proposals, and who approves them."""
