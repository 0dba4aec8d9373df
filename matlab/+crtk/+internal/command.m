function varargout = command(device, name, varargin)
%COMMAND  Send a command. A move returns its handle, any other nothing.

    move = crtk.internal.call(crtk.internal.with_values('send', device, name, varargin));
    if move > 0
        varargout = {crtk.wait_move_handle(move)};
    end
end
