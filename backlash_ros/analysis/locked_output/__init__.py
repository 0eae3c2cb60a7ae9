"""Lost motion of a locked output, from a bag or a table: `backlash lost-motion`."""
