function value = decode(part)
%DECODE  The array that encode's counterpart in Python wrote.

    value = reshape(sscanf(part.data, '%f,'), part.size(:)');
end
