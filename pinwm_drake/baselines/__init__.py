"""Methods that lead from data and worlds to something that acts; trained, evaluated and compared alike."""
